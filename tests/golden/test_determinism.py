"""The same configuration gives the same bits, on any thread count; another one gives others."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest

from framework.command.config.schema import register_config, rows
from framework.options import TrainerOptions
from framework.records.progress import Silent
from framework.records.record import RunRecord
from framework.run.experiment import run_experiment

SCENE = {"width": 96, "height": 72, "supersampling": 2}
STEPS = 40


def _group(group: str, name: str, **changes: Any) -> dict[str, Any]:
    defaults = {key: field.default for key, _, field in rows(group, name)}
    return {"name": name, **defaults, **changes}


def _config(seed: int, threads: int, augment: str = "safi", reg: str = "uar") -> dict[str, Any]:
    register_config()
    return {
        "seed": seed,
        "study": "golden",
        "threads": threads,
        "force": True,
        "traceback": False,
        "metrics": {"lpips_weights": "none", "also": None},  # whatever the user has fetched
        "scene": _group("scene", "embedded", **SCENE),
        "depth": _group("depth", "plane_sweep", planes=48),
        "init": _group("init", "stereo", budget=3000),
        "augment": _group("augment", augment),
        "reg": _group("reg", reg),
        "capacity": _group("capacity", "adc", from_step=10, every=10, grad_threshold=1e-6),
        "trainer": asdict(TrainerOptions(steps=STEPS, evaluations=2)),
    }


def _run(folder: Path, seed: int, threads: int, **methods: str) -> RunRecord:
    return run_experiment(_config(seed, threads, **methods), folder, Silent())


@pytest.fixture(scope="module")
def golden(tmp_path_factory: pytest.TempPathFactory) -> RunRecord:
    return _run(tmp_path_factory.mktemp("golden"), seed=0, threads=1)


@pytest.mark.parametrize("threads", [1, 3])
def test_same_bits_on_any_thread_count(golden: RunRecord, tmp_path: Path, threads: int) -> None:
    again = _run(tmp_path, seed=0, threads=threads)
    assert again.parameters_sha256 == golden.parameters_sha256
    assert again.gaussians == golden.gaussians
    assert again.summary == golden.summary


def test_the_seed_matters(golden: RunRecord, tmp_path: Path) -> None:
    other = _run(tmp_path, seed=1, threads=2)
    assert other.parameters_sha256 != golden.parameters_sha256


def test_the_methods_matter(golden: RunRecord, tmp_path: Path) -> None:
    """An option that is read but changes nothing would make a study lie."""
    bits = {golden.parameters_sha256}
    for augment, reg in (("none", "none"), ("safi", "none"), ("none", "uar")):
        record = _run(tmp_path / f"{augment}-{reg}", seed=0, threads=2, augment=augment, reg=reg)
        bits.add(record.parameters_sha256)
    assert len(bits) == 4
