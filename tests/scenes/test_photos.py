"""Photos without poses: the search, what is kept of it, and every message."""

from __future__ import annotations

import json
import logging
import shutil
import subprocess
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from framework.compute import parallel
from framework.compute.rng import stream
from framework.errors import UserError
from framework.files.whole import Unwritable
from framework.scenes import load_scene
from framework.scenes.colmap_model import read_model
from framework.scenes.images import read_image
from framework.scenes.photos import Photos, cached, child
from framework.scenes.photos.advice import advice, failure
from framework.scenes.photos.found import FILE, Found, Link, Overruled, read_found, write_found
from framework.scenes.photos.model import upright
from framework.scenes.photos.prepare import prepare
from framework.scenes.photos.source import Source, find_source
from framework.scenes.photos.steps import pairs, plausible
from framework.types import Scene
from tests.data import open_scene
from tests.scenes.pictures import FOCAL, HEIGHT, WIDTH, exif_of, photograph, rig, write_photos

SIDE, FRAMES = 1200, 40


def load(folder: Path, **options: object) -> Scene:
    return load_scene("photos", {"path": str(folder), **options})


def source_of(folder: Path) -> Source:
    return find_source(str(folder), SIDE, FRAMES)


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the room's photos, with their poses beside them."""
    folder = write_photos(tmp_path_factory.mktemp("photos") / "my room")
    before = parallel.threads()
    parallel.set_threads(1)
    try:
        load(folder)
    finally:
        parallel.set_threads(before)
    return folder


def kept(room: Path) -> Path:
    (folder,) = room.glob("fishersplat-poses-*")
    return folder


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


def test_it_stands_upright(room: Path) -> None:
    views = np.array(read_model(kept(room) / "sparse" / "0").viewmats)
    assert views[:, 1, 1].mean() > 0.99 and views[:, 2, 2].mean() > 0.9  # down is +y, ahead +z
    centers = -np.einsum("nji,nj->ni", views[:, :3, :3], views[:, :3, 3])
    assert np.abs(centers.mean(axis=0)).max() < 1e-9


def test_the_search_repeats_bit_for_bit_on_other_threads(room: Path, tmp_path: Path) -> None:
    before = parallel.threads()
    parallel.set_threads(2)
    try:
        child.run_child(source_of(room), tmp_path)
    finally:
        parallel.set_threads(before)
    for stem in ("cameras", "images", "points3D"):
        name = f"sparse/0/{stem}.bin"
        assert (tmp_path / name).read_bytes() == (kept(room) / name).read_bytes(), stem


def test_what_was_found_is_used_again(room: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cached, "run_child", lambda *_: pytest.fail("searched again"))
    first = load(room).fingerprint
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
    """Stands in for the search."""
    time.sleep(0.2)
    (folder / "images").mkdir()
    (folder / "sparse").mkdir()
    write_found(folder, FOUND)


def noise_photos(folder: Path, n: int = 3) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for i in range(n):
        pixels = stream(i, "tests/photos").integers(0, 256, (48, 64, 3), dtype=np.uint8)
        Image.fromarray(pixels).save(folder / f"n{i}.png")
    return folder


def test_two_at_once_do_it_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    calls: list[Path] = []

    def search(source: Source, folder: Path) -> None:
        calls.append(folder)
        stored_by_hand(source, folder)

    monkeypatch.setattr(cached, "run_child", search)
    source, found = source_of(noise_photos(tmp_path / "p")), []
    with caplog.at_level(logging.INFO, "framework"):
        threads = [
            threading.Thread(target=lambda: found.append(cached.poses_folder(source)))
            for _ in range(2)
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert len(calls) == 1 and found[0] == found[1] and (found[0] / FILE).is_file()
    assert "waiting for another process" in caplog.text
    assert [p.name for p in source.beside.iterdir() if p.name.startswith(".")] == []


def test_a_folder_that_cannot_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    photos, real = noise_photos(tmp_path / "photos"), cached.locked

    def locked(folder: Path, wait: bool = False) -> object:
        if photos in folder.parents:
            raise Unwritable("read-only")
        return real(folder, wait)

    monkeypatch.setattr(cached, "run_child", stored_by_hand)
    monkeypatch.setattr(cached, "locked", locked)
    monkeypatch.setenv("FISHERSPLAT_CACHE", str(tmp_path / "cache"))
    with caplog.at_level(logging.INFO, "framework"):
        folder = cached.poses_folder(source_of(photos))
    assert folder.parent == tmp_path / "cache" / "poses" and "cannot be written" in caplog.text
    assert cached.poses_folder(source_of(photos)) == folder


@pytest.mark.parametrize("error", [KeyboardInterrupt(), UserError("too little overlap")])
def test_a_search_that_fails_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: BaseException
) -> None:
    def search(source: Source, folder: Path) -> None:
        (folder / "half").write_text("half")
        raise error

    monkeypatch.setattr(cached, "run_child", search)
    source = source_of(noise_photos(tmp_path / "photos"))
    with pytest.raises(type(error)):
        cached.poses_folder(source)
    assert sorted(p.name for p in source.beside.iterdir()) == ["n0.png", "n1.png", "n2.png"]


def test_what_is_damaged_is_made_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cached, "run_child", stored_by_hand)
    source = source_of(noise_photos(tmp_path / "photos"))
    folder = cached.poses_folder(source)
    (folder / "sparse").rmdir()
    assert cached.poses_folder(source) == folder and (folder / "sparse").is_dir()
    (folder / FILE).write_text("{}")
    with pytest.raises(UserError, match=r"damaged one .KeyError.; remove the folder fishersplat"):
        read_found(folder)


def test_an_interrupt_ends_the_child(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    started: list[subprocess.Popen[str]] = []

    def listen(process: subprocess.Popen[str], *_: object) -> None:
        started.append(process)
        raise KeyboardInterrupt

    monkeypatch.setattr(child, "_listen", listen)
    with pytest.raises(KeyboardInterrupt):
        child.run_child(source_of(noise_photos(tmp_path / "photos")), tmp_path)
    assert started[0].poll() is not None


def test_a_child_that_ends_suddenly(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(child, "MODULE", "no_such_module")
    with pytest.raises(UserError, match=r"its process ended with 1 .*No module named no_such"):
        child.run_child(source_of(noise_photos(tmp_path / "photos")), tmp_path)


def test_photos_that_show_nothing(tmp_path: Path) -> None:
    for i in range(3):
        Image.new("RGB", (160, 120), (90 + i, 90, 90)).save(tmp_path / f"wall{i}.png")
    with pytest.raises(UserError, match=r"3 of 3 photos without enough texture .wall0.png, wall1"):
        load(tmp_path)
    assert len(list(tmp_path.iterdir())) == 3


def test_a_damaged_photo_is_named(tmp_path: Path) -> None:
    noise_photos(tmp_path)
    (tmp_path / "n1.png").write_bytes((tmp_path / "n1.png").read_bytes()[:2000])
    with pytest.raises(UserError, match=r"n1.png: expected a readable image, got a damaged file"):
        load(tmp_path)


@pytest.mark.parametrize("turn", range(1, 9))
def test_exif_turns_are_done(tmp_path: Path, turn: int) -> None:
    """Each of EXIF's eight orientations ends in the same upright photo."""
    T = Image.Transpose
    as_stored = {
        **{2: T.FLIP_LEFT_RIGHT, 3: T.ROTATE_180, 4: T.FLIP_TOP_BOTTOM, 5: T.TRANSPOSE},
        **{6: T.ROTATE_90, 7: T.TRANSVERSE, 8: T.ROTATE_270},
    }
    pixels = photograph(rig(6)[2])
    image = Image.fromarray(pixels)
    stored = image.transpose(as_stored[turn]) if turn > 1 else image
    stored.save(tmp_path / "a.jpg", quality=98, subsampling=0, exif=exif_of(turn))
    (tmp_path / "out").mkdir()
    photo = prepare(tmp_path / "a.jpg", tmp_path / "out", 0, SIDE)
    assert (photo.width, photo.height, photo.name) == (WIDTH, HEIGHT, "a.jpg")
    shown = read_image(tmp_path / "out" / photo.stored).astype(float)
    assert np.abs(shown - pixels).mean() < 3
    assert photo.focal_px == pytest.approx(FOCAL, rel=0.02)


def test_large_photos_are_reduced(tmp_path: Path) -> None:
    image = Image.fromarray(photograph(rig(6)[0])).resize((1600, 1200))
    image.save(tmp_path / "a.jpg", exif=exif_of())
    photo = prepare(tmp_path / "a.jpg", tmp_path, 7, 400)
    assert photo.reduced and (photo.width, photo.height) == (400, 300)
    assert photo.focal_px == pytest.approx(FOCAL * 400 / WIDTH, rel=0.02)
    assert Image.open(tmp_path / photo.stored).size == (400, 300)


def test_focal_length_of_the_sensor(tmp_path: Path) -> None:
    exif = exif_of(film_mm=None)
    tags = exif.get_ifd(0x8769)
    tags[0x920A], tags[0xA20E], tags[0xA210] = 5.0, 160.0, 3  # mm, pixels per cm
    Image.new("RGB", (160, 120)).save(tmp_path / "a.jpg", exif=exif)
    assert prepare(tmp_path / "a.jpg", tmp_path, 0, SIDE).focal_px == pytest.approx(80.0)
    tags[0xA20E] = 0.0
    Image.new("RGB", (160, 120)).save(tmp_path / "a.jpg", exif=exif)
    assert prepare(tmp_path / "a.jpg", tmp_path, 0, SIDE).focal_px is None


def test_photos_that_are_not_read(tmp_path: Path) -> None:
    Image.new("RGBA", (64, 48)).save(tmp_path / "a.png")
    with pytest.raises(UserError, match="expected an opaque photo, got transparency"):
        prepare(tmp_path / "a.png", tmp_path, 0, SIDE)
    Image.new("I;16", (64, 48)).save(tmp_path / "a.png")
    with pytest.raises(UserError, match=r"expected a photo of 8 bits .* got mode I;16; convert it"):
        prepare(tmp_path / "a.png", tmp_path, 0, SIDE)


def test_heic_needs_a_reader(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("framework.scenes.photos.prepare.HEIF_READERS", ("none_of_this_name",))
    (tmp_path / "a.HEIC").write_bytes(b"heic")
    with pytest.raises(UserError, match=r"got HEIC, .* pip install pi-heif, or convert it to JPEG"):
        prepare(tmp_path / "a.HEIC", tmp_path, 0, SIDE)


def test_heic_is_read_where_there_is_one(tmp_path: Path) -> None:
    """One of 48x32 pixels, red at its top left, that says to turn it right and that the focal
    length is that of 28 mm on film."""
    pytest.importorskip("pi_heif", reason="reads HEIC; no dependency, see docs/photos.md")
    photo = prepare(Path(__file__).with_name("turned.heic"), tmp_path, 0, SIDE)
    assert (photo.name, photo.width, photo.height) == ("turned.heic.jpg", 32, 48)
    assert photo.focal_px == pytest.approx(28 / 43.27 * np.hypot(32, 48), rel=1e-3)
    pixels = read_image(tmp_path / photo.stored).astype(int)
    assert np.abs(pixels[8, 24] - (230, 40, 30)).max() < 12
    assert np.abs(pixels[40, 8] - (40, 60, 80)).max() < 12


def test_folders_without_enough_photos(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"expected a folder of photos or a video .* found nothing"):
        load(tmp_path / "nowhere")
    with pytest.raises(UserError, match=r"expected photos \(.heic, .heif, .jpeg, .jpg.* got none"):
        load(tmp_path)
    (tmp_path / "more").mkdir()
    with pytest.raises(UserError, match=r"got only folders \(more\)"):
        load(tmp_path)
    (tmp_path / "a.dng").touch()
    with pytest.raises(UserError, match=r"got 1 pictures of other kinds \(first: a.dng\); convert"):
        load(tmp_path)
    (tmp_path / "clip.mp4").touch()
    with pytest.raises(UserError, match=r"got a video; give it itself, scene.path=.*clip.mp4"):
        load(tmp_path)
    with pytest.raises(UserError, match=r"a.dng: expected a folder of photos or a video \(.avi"):
        load(tmp_path / "a.dng")
    noise_photos(tmp_path, 1)
    with pytest.raises(UserError, match="expected at least 3 different photos, got 1; take more"):
        load(tmp_path)
    shutil.copyfile(tmp_path / "n0.png", tmp_path / "n9.png")
    with pytest.raises(UserError, match="got the same photo 2 times"):
        load(tmp_path)
    noise_photos(tmp_path, 3)
    assert source_of(tmp_path).copies == {"n9.png": "n0.png"}


def test_photos_in_a_folder_of_their_own(tmp_path: Path) -> None:
    noise_photos(tmp_path / "holiday" / "images")
    source = source_of(tmp_path / "holiday")
    assert (source.title, len(source.files)) == ("holiday", 3)
    assert source.beside == tmp_path / "holiday" / "images"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"side": 10}, "scene.side: expected 64 to 8192 pixels, got 10"),
        ({"frames": 2}, "scene.frames: expected 3 to 1000, got 2"),
        ({"n_views": -1}, "expected n_views to be an integer >= 1 or all, got -1"),
        ({"downscale": -2}, "expected downscale to be an integer >= 1, got -2"),
        ({"split": "odd"}, "split=odd: unknown protocol"),
        ({"path": ""}, "give scene.path=DIR"),
    ],
)
def test_bad_options(options: dict[str, object], message: str) -> None:
    with pytest.raises(UserError, match=message):
        Photos(**{"path": "p", **options})  # type: ignore[arg-type]


def test_colmap_without_a_model_tells_of_this(tmp_path: Path) -> None:
    noise_photos(tmp_path / "images")
    with pytest.raises(UserError, match="For photos without poses: scene=photos"):
        load_scene("colmap", {"path": str(tmp_path)})


NAMES = [f"p{k:02d}.jpg" for k in range(12)]
FOUND = Found(
    photos=NAMES,
    placed=dict.fromkeys(NAMES, 200),
    groups=[],
    features=dict.fromkeys(NAMES, 800),
    links=[
        Link(a, b, 100 - 10 * abs(i - j), 0.05 * abs(i - j))
        for j, b in enumerate(NAMES)
        for i, a in enumerate(NAMES[:j])
        if abs(i - j) < 4
    ],
    tries=[],
    seconds=9.0,
)


def placed(*missing: int) -> dict[str, int]:
    return {name: 200 for k, name in enumerate(NAMES) if k not in missing}


def test_nothing_to_tell() -> None:
    assert list(advice(FOUND)) == []


def test_advice_names_photos_and_neighbours() -> None:
    (line,) = advice(replace(FOUND, placed=placed(5)))
    assert line.startswith(
        "1 of 12 photos found no place: p05.jpg (matches: p04.jpg 90, p06.jpg 90); take more"
    )
    features = {**FOUND.features, "p05.jpg": 3}
    (line,) = advice(replace(FOUND, placed=placed(5), features=features))
    assert "p05.jpg (too little texture)" in line
    (line,) = advice(replace(FOUND, placed=placed(*range(6, 12)), links=[]))
    assert "p10.jpg (matches: none) and 1 more" in line


def test_advice_about_groups_weak_poses_copies_and_focal_length() -> None:
    (line,) = advice(replace(FOUND, placed=placed(0, 1, 2), groups=[NAMES[:3]]))
    assert line.startswith("3 photos belong together, but not to the other 9: p00.jpg, p01.jpg")
    (line,) = advice(replace(FOUND, placed={**placed(), "p03.jpg": 7}))
    assert line.startswith("placed by few points, so perhaps wrongly: p03.jpg (7)")
    (line,) = advice(replace(FOUND, copies={"b.jpg": "a.jpg"}))
    assert line == "left out as copies: b.jpg is a.jpg"
    (line,) = advice(replace(FOUND, held=True))
    assert line.startswith("the photos do not tell the focal length")


def test_advice_about_a_focal_length_in_exif_that_is_wrong() -> None:
    (line,) = advice(replace(FOUND, overruled=Overruled(377.0, 609.0, 0.68, 0.18)))
    assert "609 pixels, is what the photos tell, not EXIF's 377, which fits worse (by 0.68" in line
    (line,) = advice(replace(FOUND, overruled=Overruled(377.0, 609.0, None, 0.18)))
    assert "with which fewer photos find a place; were they cropped or edited?" in line


def test_frames_of_a_video_are_recognised() -> None:
    near = replace(FOUND, links=[replace(link, shift=link.shift / 9) for link in FOUND.links])
    (line,) = advice(near)
    assert line.startswith("neighbouring photos are nearly the same, as frames of a video are")
    assert list(advice(replace(near, video=True))) == []


def test_failures_say_why() -> None:
    def told(found: Found) -> str:
        text = failure(Path("holiday/p00.jpg"), found)
        assert text.startswith("holiday: expected photos") and "\n" not in text
        return text

    nothing = replace(FOUND, placed={})
    assert "12 of 12 photos without enough" in told(
        replace(nothing, features=dict.fromkeys(NAMES, 9))
    )
    assert "at most 0 matches between two" in told(replace(nothing, links=[]))
    still = [replace(link, shift=0.001) for link in FOUND.links]
    assert "photos from one place (matches move by 0.1 %" in told(replace(nothing, links=still))
    assert "or a camera that only turned (30 pairs" in told(nothing)
    video = failure(Path("clip.mp4"), replace(nothing, links=[], video=True))
    assert video.startswith("clip.mp4: expected")


def test_which_photos_are_compared() -> None:
    assert len(pairs(60)) == 60 * 59 // 2
    chosen = pairs(300)
    assert len(set(chosen)) == len(chosen) < 5000
    assert {(0, 10), (0, 290), (5, 15), (7, 39)} <= set(chosen) and (5, 290) not in chosen


def test_plausible_cameras() -> None:
    assert plausible(600, 0.1, 640) and plausible(300, -0.1, 640)
    assert not plausible(50, 0.0, 640) and not plausible(600, 0.9, 640)


def test_upright_of_odd_cameras() -> None:
    """Cameras that look straight down, or are held every way, still give a rotation."""
    down = np.zeros((2, 3, 4))
    down[:, 0, 0], down[:, 1, 2], down[:, 2, 1] = 1, -1, 1  # ahead is the world's +y
    flipped = np.eye(4)[None, :3].repeat(2, axis=0)
    flipped[1, :2, :2] *= -1
    for views in (down, flipped):
        turn, _ = upright(views)
        assert np.allclose(turn @ turn.T, np.eye(3)) and np.linalg.det(turn) == pytest.approx(1)


def test_real_photos(tmp_path: Path) -> None:
    for k in (0, 4, 8, 12, 16):
        name = f"image{k:03d}.png"
        shutil.copyfile(open_scene("llff_fern") / "images" / name, tmp_path / name)
    load(tmp_path)
    assert len(read_found(kept(tmp_path)).placed) == 5


@pytest.mark.parametrize(
    "change",
    [
        {"groups": None},
        {"placed": ["a.jpg", "b.jpg", "c.jpg"]},
        {"placed": {}},
        {"placed": {"../a.jpg": 3, "b.jpg": 3, "c.jpg": 3}, "photos": ["../a.jpg", "b.jpg"]},
        {"links": [{"first": "a.jpg", "second": "a.jpg", "matches": 3, "shift": 0.1}]},
        {"features": {"a.jpg": "many"}},
        {"seconds": 1e999},
    ],
    ids=lambda change: next(iter(change)),
)
def test_kept_poses_of_other_types_are_refused(tmp_path: Path, change: dict[str, object]) -> None:
    names = ["a.jpg", "b.jpg", "c.jpg"]
    found = Found(names, dict.fromkeys(names, 9), [], dict.fromkeys(names, 99), [], [], 1.0)
    write_found(tmp_path, found)
    assert read_found(tmp_path) == found
    told = json.loads((tmp_path / "poses.json").read_text()) | change
    (tmp_path / "poses.json").write_text(json.dumps(told))
    with pytest.raises(UserError, match="expected the kept result of a search for poses, got"):
        read_found(tmp_path)


def test_a_decoder_that_finds_the_end_too_early_is_told_in_a_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """pi-heif raises EOFError for a damaged HEIC."""
    Image.new("RGB", (200, 150)).save(tmp_path / "a.jpg")

    def ends(*_: object, **__: object) -> None:
        raise EOFError("Decoder plugin generated an error: Unexpected end of file")

    monkeypatch.setattr(Image.Image, "thumbnail", ends)
    with pytest.raises(UserError, match=r"a.jpg: expected a readable image, got a damaged file"):
        prepare(tmp_path / "a.jpg", tmp_path, 0, 64)
