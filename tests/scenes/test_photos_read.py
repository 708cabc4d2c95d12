"""Photos without poses: which are read, how, and what is refused."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from framework.errors import UserError
from framework.scenes.images import read_image
from framework.scenes.photos import Photos
from framework.scenes.photos.attempt import Attempt
from framework.scenes.photos.prepare import prepare
from framework.scenes.photos.search import store
from framework.scenes.photos.source import find_source
from tests.built import load_scene
from tests.scenes.pictures import FOCAL, HEIGHT, WIDTH, exif_of, photograph, rig
from tests.scenes.unplaced import SIDE, load, noise_photos, source_of


def found_model(names: list[str]) -> Any:
    """What the search would have found of these photos: cameras in a row."""
    pycolmap = pytest.importorskip("pycolmap")
    model = pycolmap.Reconstruction()
    camera = pycolmap.Camera.create_from_model_name(1, "PINHOLE", 60.0, 64, 48)
    model.add_camera_with_trivial_rig(camera)
    for number, name in enumerate(names, start=1):
        image = pycolmap.Image(name=name, camera_id=1, image_id=number)
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(), np.array([-0.1 * number, 0, 0]))
        model.add_image_with_trivial_frame(image, pose)
    return model


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


def test_a_palette_is_reduced_as_its_colours_are(tmp_path: Path) -> None:
    stripes = np.zeros((600, 800, 3), np.uint8)
    stripes[:, ::2] = 255
    for name, image in (
        ("rgb", Image.fromarray(stripes)),
        ("p", Image.fromarray(stripes).quantize()),
    ):
        image.save(tmp_path / f"{name}.png")
        photo = prepare(tmp_path / f"{name}.png", tmp_path, 7, 400)
        assert 120 < read_image(tmp_path / photo.stored).mean() < 135


def test_a_jpeg_beside_the_heic_of_its_name_is_the_same_photo(tmp_path: Path) -> None:
    for i, png in enumerate(sorted(noise_photos(tmp_path).glob("*.png"))):
        png.rename(tmp_path / f"IMG_{i}.jpg")
    (tmp_path / "img_1.HEIC").write_bytes(b"the same photo")
    actual = find_source(str(tmp_path), SIDE, 0)
    assert actual.copies == {"img_1.HEIC": "IMG_1.jpg"}
    assert [file.name for file in actual.files] == ["IMG_0.jpg", "IMG_1.jpg", "IMG_2.jpg"]


def test_focal_length_of_the_sensor(tmp_path: Path) -> None:
    exif = exif_of(film_mm=None)
    tags = exif.get_ifd(0x8769)
    tags[0x920A], tags[0xA20E], tags[0xA210] = 5.0, 160.0, 3  # mm, pixels per cm
    Image.new("RGB", (160, 120)).save(tmp_path / "a.jpg", exif=exif)
    assert prepare(tmp_path / "a.jpg", tmp_path, 0, SIDE).focal_px == pytest.approx(80.0)
    tags[0xA20E] = 0.0
    Image.new("RGB", (160, 120)).save(tmp_path / "a.jpg", exif=exif)
    assert prepare(tmp_path / "a.jpg", tmp_path, 0, SIDE).focal_px is None


def test_focal_length_of_a_photo_that_was_turned(tmp_path: Path) -> None:
    """4,000 pixels of 36 mm behind 50 mm, kept upright with the sides in EXIF exchanged."""
    exif = exif_of(film_mm=None)
    tags = exif.get_ifd(0x8769)
    tags[0x920A], tags[0xA20E], tags[0xA210] = 50.0, 4000 / 3.6, 3
    focals = []
    for width, height in ((400, 300), (300, 400)):
        tags[0xA002], tags[0xA003] = 10 * width, 10 * height
        Image.new("RGB", (width, height)).save(tmp_path / "a.jpg", exif=exif)
        focals.append(prepare(tmp_path / "a.jpg", tmp_path, 0, SIDE).focal_px)
    assert focals[0] == pytest.approx(400 / 36 * 50, rel=1e-3) and focals[1] == focals[0]


def test_photos_called_as_the_prepared_ones_keep_their_pixels(tmp_path: Path) -> None:
    """`000001.png` is also the name under which the second photo is prepared."""
    images = tmp_path / "images"
    images.mkdir()
    photos = []
    for number in range(4):
        source = tmp_path / f"{number + 1:06d}.png"
        Image.new("RGB", (64, 48), (60 * number, 0, 0)).save(source)
        photos.append(prepare(source, images, number, SIDE))
    placed = [photo.name for photo in photos if photo.name != "000003.png"]
    reference = dict.fromkeys(placed, 100)
    model = found_model([photo.stored for photo in photos if photo.name in placed])
    store(Attempt(model, placed=reference), photos, tmp_path)
    assert sorted(file.name for file in images.iterdir()) == placed
    assert [int(read_image(images / name)[0, 0, 0]) for name in placed] == [0, 60, 180]
    assert not (tmp_path / "prepared").exists()


def test_transparent_photos_keep_their_alpha(tmp_path: Path) -> None:
    Image.new("RGBA", (2 * SIDE, SIDE), (9, 9, 9, 0)).save(tmp_path / "a.png")
    photo = prepare(tmp_path / "a.png", tmp_path, 0, SIDE)
    with Image.open(tmp_path / photo.stored) as stored:
        assert (stored.mode, stored.size) == ("RGBA", (SIDE, SIDE // 2))
        assert stored.getchannel("A").getextrema() == (0, 0)


def test_photos_that_are_not_read(tmp_path: Path) -> None:
    Image.new("F", (64, 48)).save(tmp_path / "a.png", format="TIFF")
    with pytest.raises(UserError, match=r"expected 8 or 16 bits .* got mode F; convert it"):
        prepare(tmp_path / "a.png", tmp_path, 0, SIDE)


def test_heic_needs_a_reader(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("framework.scenes.formats.HEIF_READERS", ("none_of_this_name",))
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
    with pytest.raises(UserError, match=r"expected photos \(.bmp, .heic, .heif, .* got none"):
        load(tmp_path)
    (tmp_path / "more").mkdir()
    with pytest.raises(UserError, match=r"got only folders \(more\)"):
        load(tmp_path)
    (tmp_path / "a.dng").touch()
    with pytest.raises(UserError, match=r"got 1 pictures in other formats \(a.dng\); convert"):
        load(tmp_path)
    (tmp_path / "clip.mp4").touch()
    with pytest.raises(UserError, match=r"got a video; use scene.path=.*clip.mp4"):
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
    assert source.folder == tmp_path / "holiday" / "images"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"side": 10}, "scene.side: expected 64 to 8192 pixels, got 10"),
        ({"frames": 2}, "scene.frames: expected 3 to 1000, got 2"),
        ({"n_views": -1}, "expected n_views to be an integer >= 1 or all, got -1"),
        ({"downscale": -2}, "expected downscale to be an integer >= 1, got -2"),
        ({"split": "odd"}, "^scene.split=odd: unknown protocol"),
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
