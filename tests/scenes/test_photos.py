"""Photos without poses: the search, and what is kept of it."""

from __future__ import annotations

import errno
import json
import logging
import os
import shutil
import subprocess
import threading
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
from framework.scenes.photos.result import FILE, Result, read_result, write_result
from framework.scenes.photos.source import Source, find_source
from tests.built import load_scene
from tests.data import open_scene
from tests.scenes.pictures import FOCAL, WIDTH, photograph, rig, write_photos
from tests.scenes.unplaced import FOUND, FRAMES, kept, load, noise_photos, source_of


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


def test_the_scene_is_that_of_colmap(room: Path) -> None:
    scene = load(room)
    assert scene.name == "my room" and scene.protocol == "llff"
    assert [view.name for view in scene.test] == ["room0.jpg"]
    assert len(scene.training.views) == 5  # all others
    assert scene.training.views[0].camera.width == WIDTH and len(scene.training.points.xyz) > 100
    options = {"path": str(kept(room)), "n_views": 5}
    assert load_scene("colmap", options).fingerprint == scene.fingerprint
    assert len(load(room, n_views=2).training.views) == 2
    untested = load(room, split="none")
    assert (len(untested.training.views), untested.test) == (6, ())
    assert load(room, downscale=2).training.views[0].camera.width == WIDTH // 2
    with pytest.raises(UserError, match=r"expected n_views of at most 5 .6 images"):
        load(room, n_views=9)


def test_masks_and_given_bounds(room: Path, tmp_path: Path) -> None:
    folder = tmp_path / "room"
    shutil.copytree(room, folder)
    (folder / "masks").mkdir()
    for k in range(6):
        with Image.open(folder / f"room{k}.jpg") as photo:
            half = Image.new("L", photo.size, 255)
        half.paste(0, (0, 0, half.width // 2, half.height))
        half.save(folder / f"masks/room{k}.jpg.png")
    scene = load(folder, near=0.5, far=90.0)
    assert (scene.training.near, scene.training.far) == (0.5, 90.0)
    for view in (*scene.training.views, *scene.test):
        assert view.mask is not None and 0.4 < float(view.mask.mean()) <= 0.5


def test_it_stands_upright(room: Path) -> None:
    views = np.array(read_model(kept(room) / "sparse" / "0").viewmats)
    assert views[:, 1, 1].mean() > 0.99 and views[:, 2, 2].mean() > 0.9  # down is +y, ahead +z
    centers = -np.einsum("nji,nj->ni", views[:, :3, :3], views[:, :3, 3])
    assert np.abs(centers.mean(axis=0)).max() < 1e-9


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


def test_the_key_is_the_content(room: Path, tmp_path: Path) -> None:
    key = source_of(room).key
    assert find_source(str(room), 600, FRAMES).key != key
    shutil.copytree(room, tmp_path / "copy")
    assert source_of(tmp_path / "copy").key == key
    Image.fromarray(photograph(rig(6)[0])).save(tmp_path / "copy" / "room7.png")
    assert source_of(tmp_path / "copy").key != key


def stored_by_hand(source: Source, folder: Path) -> None:
    """Replaces the search."""
    time.sleep(0.2)
    (folder / "images").mkdir()
    (folder / "sparse").mkdir()
    write_result(folder, FOUND)


def test_two_at_once_do_it_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    calls: list[Path] = []

    def search(source: Source, folder: Path) -> None:
        calls.append(folder)
        stored_by_hand(source, folder)

    monkeypatch.setattr(process, "run_child", search)
    source, actual = source_of(noise_photos(tmp_path / "p")), []
    with caplog.at_level(logging.INFO, "framework"):
        threads = [
            threading.Thread(target=lambda: actual.append(process.poses_folder(source)))
            for _ in range(2)
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert len(calls) == 1 and actual[0] == actual[1] and (actual[0] / FILE).is_file()
    assert "waiting for another process" in caplog.text
    assert [p.name for p in source.folder.iterdir() if p.name.startswith(".")] == []


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


@pytest.mark.parametrize("error", [KeyboardInterrupt(), UserError("too little overlap")])
def test_a_search_that_fails_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: BaseException
) -> None:
    def search(source: Source, folder: Path) -> None:
        (folder / "half").write_text("half")
        raise error

    monkeypatch.setattr(process, "run_child", search)
    source = source_of(noise_photos(tmp_path / "photos"))
    with pytest.raises(type(error)):
        process.poses_folder(source)
    assert sorted(p.name for p in source.folder.iterdir()) == ["n0.png", "n1.png", "n2.png"]


def test_what_is_damaged_is_made_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(process, "run_child", stored_by_hand)
    source = source_of(noise_photos(tmp_path / "photos"))
    folder = process.poses_folder(source)
    (folder / "sparse").rmdir()
    assert process.poses_folder(source) == folder and (folder / "sparse").is_dir()
    (folder / FILE).write_text("{}")
    with pytest.raises(UserError, match=r"damaged one .KeyError.; remove the folder fishersplat"):
        read_result(folder)


def test_an_interrupt_ends_the_child(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    started: list[subprocess.Popen[str]] = []

    def listen(process: subprocess.Popen[str], *_: object) -> None:
        started.append(process)
        raise KeyboardInterrupt

    monkeypatch.setattr(process, "_listen", listen)
    with pytest.raises(KeyboardInterrupt):
        process.run_child(source_of(noise_photos(tmp_path / "photos")), tmp_path)
    assert started[0].poll() is not None


def test_a_child_that_ends_suddenly(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(process, "MODULE", "no_such_module")
    with pytest.raises(UserError, match=r"its process ended with 1 .*No module named no_such"):
        process.run_child(source_of(noise_photos(tmp_path / "photos")), tmp_path)


def test_photos_that_show_nothing(tmp_path: Path) -> None:
    for i in range(3):
        Image.new("RGB", (160, 120), (90 + i, 90, 90)).save(tmp_path / f"wall{i}.png")
    with pytest.raises(UserError, match=r"3 of 3 photos without enough texture .wall0.png, wall1"):
        load(tmp_path)
    assert len(list(tmp_path.iterdir())) == 3


def test_real_photos(tmp_path: Path) -> None:
    for k in (0, 4, 8, 12, 16):
        name = f"image{k:03d}.png"
        shutil.copyfile(open_scene("llff_fern") / "images" / name, tmp_path / name)
    load(tmp_path)
    assert len(read_result(kept(tmp_path)).placed) == 5


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
    actual = Result(names, dict.fromkeys(names, 9), [], dict.fromkeys(names, 99), [], [], 1.0)
    write_result(tmp_path, actual)
    assert read_result(tmp_path) == actual
    message = json.loads((tmp_path / "poses.json").read_text()) | change
    (tmp_path / "poses.json").write_text(json.dumps(message))
    with pytest.raises(UserError, match="expected the kept result of a search for poses, got"):
        read_result(tmp_path)
