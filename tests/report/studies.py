"""Made-up studies: archives whose runs have given numbers."""

import hashlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TypeVar

import numpy as np
import yaml

from framework.metrics.values import METRICS as MEASURED
from framework.metrics.values import Missing
from framework.records.archive import ARCHIVE, Entry, archive
from framework.records.record import Run, RunRecord, SceneInfo, StageTime
from framework.records.run_files import Table
from framework.report import build_report
from framework.report.study.methods import Method
from framework.report.study.study import Study
from tests.record.fakes import make_config

V = TypeVar("V")

BUDGETS = {"steps": "trainer.steps", "budget": "init.budget"}  # by their short names

Row = dict[str, object]


def row(scene: str, method: str, seed: int, psnr: float | str, **more: object) -> Row:
    """A run of a study; PSNR with a noise of 0.01 dB that seed and method decide."""
    noise = 0.01 * ((seed * 7 + len(method)) % 5 - 2)
    value = psnr if isinstance(psnr, str) else psnr + noise
    reference = {"scene": scene, "method": method, "seed": seed, "psnr": value}
    rest = {"gaussians": 100, "train_wall_s": 10, "train_cpu_s": 10}
    return reference | rest | {"run": f"{scene}-{method}-s{seed}".replace(" ", "")} | more


def table(folder: Path, rows: Iterable[Row]) -> Path:
    """A folder in which an archive of these runs is all that there is."""
    folder.mkdir(parents=True, exist_ok=True)
    entries = [Entry(_run(folder, one)) for one in rows]
    (folder / ARCHIVE).write_text(archive(entries), encoding="utf-8")
    return folder


def _run(folder: Path, one: Row) -> Run:
    pair, *options = str(one["method"]).split(", ")
    augment, reg = pair.split(" + ")
    config = make_config(augment, reg, int(str(one["seed"])))
    for option in options:
        key, _, value = option.partition("=")
        group, _, name = BUDGETS.get(key, key).partition(".")
        config[group][name or "name"] = yaml.safe_load(value)
    if "capacity" in one:
        config["capacity"] = {"name": one["capacity"]}
    name, _, conditions = str(one["scene"]).partition(" (")
    config["scene"] = {"name": name} | dict(
        (key, yaml.safe_load(value))
        for key, _, value in (c.partition("=") for c in conditions.rstrip(")").split(", ") if c)
    )
    fingerprint = hashlib.sha256(str(one["scene"]).encode()).hexdigest()
    cpu, _, cores = str(one.get("cpu", "cpu, 2 cores")).partition(", ")
    views = tuple(map(str, range(int(str(one.get("scene.n_views", 0))))))
    seconds = StageTime(float(str(one["train_wall_s"])), float(str(one["train_cpu_s"])))
    record = RunRecord(
        identity="",
        config=config,
        overrides=(),
        scene=SceneInfo(name, str(one.get("protocol", "own")), fingerprint, views, ()),
        timings={"train": seconds},
        provenance={"cpu": cpu, "cores": int(cores.split()[0])},
        gaussians=int(str(one["gaussians"])),
        ply_bytes=int(str(one.get("ply_bytes", 0))),
        parameters_sha256=hashlib.sha256(str(one["run"]).encode()).hexdigest(),
        summary={
            key: float(str(one[key])) if one.get(key, "") != "" else Missing("not measured")
            for key in MEASURED
        },
    )
    metrics = Table(
        {key: [] for key in ("view", "tags", "file", "missing")},
        {k: np.zeros(0) for k in (*MEASURED, "render_s")},
    )
    course = Table({}, {key: np.zeros(0) for key in ("step", "seconds", "test_psnr")})
    return Run(folder / "runs" / str(one["run"]), record, metrics, course)


def labelled(by_method: Mapping[Method, V]) -> dict[str, V]:
    """Runs by the label of the method."""
    return {method.label: value for method, value in by_method.items()}


def called(study: Study, label: str) -> Method:
    """The method of a study with this label."""
    return next(method for method in study.methods if method.label == label)


def first_screen(folder: Path, **options: object) -> str:
    """The text of a report before its first section."""
    out = folder.with_name(f"{folder.name}_report")
    text = build_report(folder, out_dir=out, **options).path.read_text(encoding="utf-8")  # type: ignore[arg-type]
    return text.partition("\n## ")[0]
