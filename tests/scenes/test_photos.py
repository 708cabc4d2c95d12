"""Photos without poses: the search, and what is kept of it."""

import errno
import json
import logging
import os
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from framework.compute import parallel
from framework.errors import UserError
from framework.scenes.colmap_model import read_model
from framework.scenes.photos import process
from framework.scenes.photos.result import Result, read_result, write_result
from framework.scenes.photos.source import Source
from tests.scenes.pictures import FOCAL, rig, write_photos
from tests.scenes.unplaced import FOUND, kept, load, noise_photos, source_of


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the room's photos, whose poses are in the cache."""
    folder = write_photos(tmp_path_factory.mktemp("photos") / "my room")
    before = parallel.threads()
    parallel.set_threads(1)
    try:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(process, "cache_dir", lambda: folder.parent / "cache")
            load(folder)
    finally:
        parallel.set_threads(before)
    return folder


@pytest.fixture(autouse=True)
def cache(
    request: pytest.FixtureRequest,
    tmp_path_factory: pytest.TempPathFactory,
    monkeypatch: pytest.MonkeyPatch,
) -> Path:
    """An empty cache, or that with the poses of the room."""
    folder = tmp_path_factory.mktemp("cache")
    if "room" in request.fixturenames:
        folder = request.getfixturevalue("room").parent / "cache"
    monkeypatch.setattr(process, "cache_dir", lambda: folder)
    return Path(folder)


def test_the_poses_are_those_of_the_cameras(room: Path) -> None:
    model = read_model(kept(room) / "sparse" / "0")
    assert model.names == [f"room{k}.jpg" for k in range(6)]
    ours, theirs = np.array(model.viewmats), np.array(rig(6))
    relative = np.einsum("nji,njk->nik", theirs[:, :3, :3], ours[:, :3, :3])
    cosine = (np.einsum("nij,ij->n", relative, relative[0]) - 1) / 2
    assert np.degrees(np.arccos(np.clip(cosine, -1, 1))).max() < 0.5
    assert [lens.fx for lens in model.lenses] == pytest.approx([FOCAL] * 6, rel=0.05)


def test_the_search_repeats_bit_for_bit_on_other_threads(room: Path, tmp_path: Path) -> None:
    before = parallel.threads()
    parallel.set_threads(2)
    try:
        process.run_child(source_of(room), tmp_path)
    finally:
        parallel.set_threads(before)
    for stem in ("cameras", "images", "points3D"):
        name = f"sparse/0/{stem}.bin"
        assert (tmp_path / name).read_bytes() == (kept(room) / name).read_bytes(), stem


def test_what_was_found_is_used_again(
    room: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(process, "run_child", lambda *_: pytest.fail("searched again"))
    with caplog.at_level(logging.INFO, "framework"):
        first = load(room).fingerprint
    assert f"6 of 6 photos have poses, kept in {kept(room)}" in caplog.text
    (room / "room0.jpg").touch()
    assert load(room).fingerprint == first
    assert [p.name for p in room.iterdir() if p.name.startswith(".")] == []


def stored_by_hand(source: Source, folder: Path) -> None:
    """Replaces the search."""
    time.sleep(0.2)
    (folder / "images").mkdir()
    (folder / "sparse").mkdir()
    write_result(folder, FOUND)


def test_nothing_is_written_beside_the_photos(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cache: Path
) -> None:
    photos, real = noise_photos(tmp_path / "photos"), os.open

    def refuse(path: str | Path, flags: int, *args: Any, **options: Any) -> int:
        if photos in Path(path).parents and flags & (os.O_WRONLY | os.O_RDWR):
            raise PermissionError(errno.EACCES, "denied", str(path))
        return real(path, flags, *args, **options)

    monkeypatch.setattr(process, "run_child", stored_by_hand)
    monkeypatch.setattr(os, "open", refuse)
    photos.chmod(0o555)  # root may write all the same
    folder = process.poses_folder(source_of(photos))
    assert folder.parent == cache / "poses"
    assert process.poses_folder(source_of(photos)) == folder
    assert sorted(p.name for p in photos.iterdir()) == ["n0.png", "n1.png", "n2.png"]


@pytest.mark.parametrize(
    "change",
    [
        {"placed": {}},
        {"links": [{"first": "a.jpg"}]},
        {"placed": {"../a.jpg": 3, "b.jpg": 3, "c.jpg": 3}, "photos": ["../a.jpg", "b.jpg"]},
    ],
    ids=lambda change: next(iter(change)),
)
def test_kept_poses_of_other_types_are_refused(tmp_path: Path, change: dict[str, object]) -> None:
    names = ["a.jpg", "b.jpg", "c.jpg"]
    poses = dict.fromkeys(names, 9), [], dict.fromkeys(names, 99), []
    actual = Result(*poses, photos=names, tries=[], seconds=1.0)
    write_result(tmp_path, actual)
    assert read_result(tmp_path) == actual
    message = json.loads((tmp_path / "poses.json").read_text()) | change
    (tmp_path / "poses.json").write_text(json.dumps(message))
    with pytest.raises(UserError, match="expected the kept result of a search for poses, got"):
        read_result(tmp_path)


def test_photos_that_show_nothing(tmp_path: Path) -> None:
    for i in range(3):
        Image.new("RGB", (160, 120), (90 + i, 90, 90)).save(tmp_path / f"wall{i}.png")
    with pytest.raises(UserError, match=r"3 of 3 photos without enough texture .wall0.png, wall1"):
        load(tmp_path)
    assert len(list(tmp_path.iterdir())) == 3
