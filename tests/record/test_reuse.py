"""A complete run is reused only while every file it read is what it was."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image

from framework.command.config.schema import register_config, rows
from framework.exports.formats import SUFFIXES
from framework.exports.render import _png
from framework.files.locks import LOCK
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
from framework.records.run_files import (
    EXPORT,
    EXPORTED,
    HISTORY_CSV,
    METRICS_CSV,
    PICTURES,
    VIDEOS,
    VIEW,
)
from framework.run import experiment
from framework.run.experiment import run_experiment
from framework.train.resume.checkpoint import FOLDER
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


def test_what_a_process_killed_at_its_end_left_is_removed(tmp_path: Path) -> None:
    config = small_config(group("depth", "plane_sweep"))
    run(config, tmp_path / "run")
    whole = sorted(tmp_path.rglob("*"))
    (tmp_path / "run" / LOCK).write_text("")
    (tmp_path / "run" / FOLDER).mkdir()
    assert run(config, tmp_path / "run")[1]
    assert sorted(tmp_path.rglob("*")) == whole


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


def test_a_damaged_table_is_no_complete_run(tmp_path: Path) -> None:
    config = small_config(group("depth", "plane_sweep"))
    run(config, tmp_path / "run")
    (tmp_path / "run" / METRICS_CSV).write_text("x", encoding="utf-8")
    assert not run(config, tmp_path / "run")[1]
    assert run(config, tmp_path / "run")[1]


def test_what_was_made_of_an_older_model_goes_with_it(tmp_path: Path) -> None:
    config = small_config(group("depth", "plane_sweep"))
    run(config, tmp_path / "run")
    built = [VIEW, *VIDEOS, f"{EXPORT}/scene.compressed.ply", f"{PICTURES}/IMG 1.png"]
    left = [tmp_path / "run" / name for name in built]
    names = [f"{EXPORT}/scene.blend", f"{PICTURES}/mine.png", "renders/mine.png", "photos/mine.jpg"]
    names += [f"{FOLDER}/mine.txt", ".mine.tmp"]
    theirs = [tmp_path / "run" / name for name in names]
    for path in (*left, *theirs):
        path.parent.mkdir(exist_ok=True)
        path.touch()
    left[-1].write_bytes(_png(np.zeros((4, 4, 3), np.uint8)))
    Image.new("RGB", (4, 4)).save(theirs[1])
    assert run(config, tmp_path / "run")[1] and all(path.exists() for path in left)
    (tmp_path / "run" / RECORD).unlink()
    run(config, tmp_path / "run")
    assert not any(path.exists() for path in left) and all(path.exists() for path in theirs)


def test_formats_that_are_removed_are_those_of_export() -> None:
    assert {f".{ending}" for ending in EXPORTED} == set(SUFFIXES.values())


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


def test_a_repeated_run_says_why_and_removes_stale_pictures(finished: Path, tmp_path: Path) -> None:
    config, folder = small_config(group("depth", "plane_sweep")), tmp_path / "run"
    shutil.copytree(finished, folder)
    truncate(folder / PLY)
    progress = Recorder()
    run_experiment(config, folder, progress)
    assert any(PLY in note and note.startswith("warning") for note in progress.notes)
    assert run(config, folder)[1]
    fewer = {**config["scene"], "n_views": 4}
    before = {path.name for path in (folder / "photos").iterdir()}
    run({**config, "scene": fewer}, folder)
    assert {path.name for path in (folder / "photos").iterdir()} != before
    assert len(list((folder / "photos").iterdir())) == 4
