"""A complete run is reused only while every file it read is what it was."""

import json
import shutil
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from framework.command.config.schema import register_config, rows
from framework.errors import UserError
from framework.metrics.values import Missing
from framework.options import TrainerOptions
from framework.records.progress import Silent
from framework.records.record import (
    PLY,
    RECORD,
    RunRecord,
    damaged_file,
    find_complete,
    read_record,
)
from framework.records.run_files import HISTORY_CSV
from framework.run import experiment
from framework.run.experiment import run_experiment
from tests.built import load_scene

SCENE = {"width": 96, "height": 72, "supersampling": 2}


class Recorder(Silent):
    """Remembers the result line and the notes."""

    def __init__(self) -> None:
        self.result, self.notes = "", list[str]()

    def note(self, text: str) -> None:
        self.notes.append(text)

    def done(self, text: str) -> None:
        self.result = text


def group(name: str, choice: str, **changes: Any) -> dict[str, Any]:
    defaults = {key: field.default for key, _, field in rows(name, choice)}
    return {"name": choice, **defaults, **changes}


def small_config(depth: dict[str, Any], weights: Path | None = None) -> dict[str, Any]:
    """A run of four steps on the embedded scene."""
    register_config()
    return {
        "seed": 0,
        "study": "reuse",
        "threads": 1,
        "force": False,
        "traceback": False,
        "metrics": {"lpips_weights": None if weights is None else str(weights)},
        "scene": group("scene", "embedded", **SCENE),
        "depth": depth,
        "init": group("init", "stereo", budget=500),
        "augment": group("augment", "none"),
        "reg": group("reg", "none"),
        "capacity": group("capacity", "fixed"),
        "trainer": asdict(TrainerOptions(steps=4, evaluations=1)),
    }


def run(config: dict[str, Any], folder: Path) -> tuple[RunRecord, bool]:
    """The record and whether it was reused."""
    progress = Recorder()
    record = run_experiment(config, folder, progress)
    return record, "reused" in progress.result


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("finished") / "run"
    run(small_config(group("depth", "plane_sweep")), folder)
    return folder


def test_a_replaced_depth_map_is_another_run(tmp_path: Path) -> None:
    maps = tmp_path / "depth"
    maps.mkdir()
    views = load_scene("embedded", SCENE).training.views
    for view in views:
        assert view.depth is not None
        np.save(maps / f"{view.name}.npy", view.depth.numpy())
    config = small_config(group("depth", "file", path=str(maps), align="none"))
    first, _ = run(config, tmp_path / "run")
    again, reused = run(config, tmp_path / "run")
    assert reused and again == first
    file = maps / f"{views[1].name}.npy"
    np.save(file, 1.1 * np.load(file))
    other, reused = run(config, tmp_path / "run")
    assert not reused and other.identity != first.identity
    assert other.parameters_sha256 != first.parameters_sha256


def test_replaced_weights_are_another_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Nothing:
        name = "nothing"

        def distance(self, x: np.ndarray, y: np.ndarray, centred: bool) -> Missing:
            return Missing("not measured here")

    monkeypatch.setattr(experiment, "load", lambda path: Nothing())
    weights = tmp_path / "weights.pt"
    torch.save({"a": torch.zeros(1)}, weights)
    config = small_config(group("depth", "ground_truth"), weights)
    first, _ = run(config, tmp_path / "run")
    assert run(config, tmp_path / "run") == (first, True)
    torch.save({"a": torch.ones(1)}, weights)
    other, reused = run(config, tmp_path / "run")
    assert not reused and other.identity != first.identity


def test_another_configuration_does_not_replace_a_complete_run(
    finished: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "run"
    shutil.copytree(finished, folder)
    config = small_config(group("depth", "plane_sweep"))
    other = config | {"reg": group("reg", "uar")}
    with pytest.raises(UserError, match=rf"{folder}: .*configuration \(reg=none, .* force=true"):
        run(other, folder)
    file = folder / RECORD
    content = json.loads(file.read_text(encoding="utf-8"))
    content["identity"] = "0" * 64  # of another version of the code, which had fewer options
    del content["config"]["trainer"]["pace_views"]
    file.write_text(json.dumps(content), encoding="utf-8")
    assert not run(config | {"threads": 2}, folder)[1]
    assert read_record(file).identity != "0" * 64
    assert run(other | {"force": True}, folder)[0].config["reg"]["name"] == "uar"


def truncate(file: Path) -> None:
    file.write_bytes(file.read_bytes()[:-100])


def flip_a_byte(file: Path) -> None:
    content = bytearray(file.read_bytes())
    content[-1] ^= 1
    file.write_bytes(content)


@pytest.mark.parametrize("name", [PLY, HISTORY_CSV, "renders/*.png", "photos/*.jpg"])
@pytest.mark.parametrize("damage", [truncate, flip_a_byte, Path.unlink])
def test_a_damaged_run_is_repeated(
    finished: Path, tmp_path: Path, name: str, damage: Callable[[Path], None]
) -> None:
    folder = tmp_path / "run"
    shutil.copytree(finished, folder)
    identity = read_record(folder / RECORD).identity
    assert find_complete(folder, identity) is not None
    file = sorted(folder.glob(name))[0]
    damage(file)
    assert find_complete(folder, identity) is None
    assert file.name in damaged_file(folder, identity)
