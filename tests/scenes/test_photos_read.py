"""Photos without poses: which are read, how, and what is refused."""

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from framework.errors import UserError
from framework.scenes.images import read_image
from framework.scenes.photos.attempt import Attempt
from framework.scenes.photos.prepare import prepare
from framework.scenes.photos.search import store
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
    with pytest.raises(UserError, match=r"expected photos \(.bmp, .heic, .heif, .* got none"):
        load(tmp_path)
    (tmp_path / "a.dng").touch()
    with pytest.raises(UserError, match=r"got 1 pictures in other formats \(a.dng\); convert"):
        load(tmp_path)
    (tmp_path / "clip.mp4").touch()
    with pytest.raises(UserError, match=r"got a video; use scene.path=.*clip.mp4"):
        load(tmp_path)
    noise_photos(tmp_path, 1)
    with pytest.raises(UserError, match="expected at least 3 different photos, got 1; take more"):
        load(tmp_path)
    shutil.copyfile(tmp_path / "n0.png", tmp_path / "n9.png")
    with pytest.raises(UserError, match="got the same photo 2 times"):
        load(tmp_path)
    noise_photos(tmp_path, 3)
    assert source_of(tmp_path).copies == {"n9.png": "n0.png"}


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
    store(Attempt(placed=reference, model=model), photos, tmp_path)
    assert sorted(file.name for file in images.iterdir()) == placed
    assert [int(read_image(images / name)[0, 0, 0]) for name in placed] == [0, 60, 180]
    assert not (tmp_path / "prepared").exists()


def test_heic_needs_a_reader(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("framework.scenes.formats.HEIF_READERS", ("none_of_this_name",))
    (tmp_path / "a.HEIC").write_bytes(b"heic")
    with pytest.raises(UserError, match=r"got HEIC, .* pip install pi-heif, or convert it to JPEG"):
        prepare(tmp_path / "a.HEIC", tmp_path, 0, SIDE)


def test_focal_length_of_the_sensor(tmp_path: Path) -> None:
    exif = exif_of(film_mm=None)
    tags = exif.get_ifd(0x8769)
    tags[0x920A], tags[0xA20E], tags[0xA210] = 5.0, 160.0, 3  # mm, pixels per cm
    Image.new("RGB", (160, 120)).save(tmp_path / "a.jpg", exif=exif)
    assert prepare(tmp_path / "a.jpg", tmp_path, 0, SIDE).focal_px == pytest.approx(80.0)
    tags[0xA20E] = 0.0
    Image.new("RGB", (160, 120)).save(tmp_path / "a.jpg", exif=exif)
    assert prepare(tmp_path / "a.jpg", tmp_path, 0, SIDE).focal_px is None
