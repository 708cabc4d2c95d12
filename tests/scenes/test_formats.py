"""Photos of every format, size and EXIF orientation, and their names, in every layout."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch
from PIL import Image

from framework.errors import UserError
from framework.scenes.formats import find_photo
from framework.scenes.images import list_images, read_image
from framework.scenes.photos.source import find_source
from framework.types import Scene
from tests.built import load_scene
from tests.scenes import test_blender, test_dtu, test_transforms
from tests.scenes.synthetic import write_llff, write_scene
from tests.scenes.unplaced import noise_photos

ORIENTATION = 0x0112
Mode = Callable[[Image.Image], Image.Image]


def write_mip360(folder: Path) -> Path:
    (write_scene(folder) / "images").rename(folder / "images_8")
    return folder


LAYOUTS: dict[str, tuple[Callable[[Path], Path], dict[str, Any]]] = {
    "colmap": (write_scene, {"n_views": 3}),
    "mip360": (write_mip360, {"n_views": 3}),
    "llff": (write_llff, {"n_views": 3}),
    "transforms": (
        lambda f: test_transforms.write(f, lambda data: data.update(w=40, h=30)),
        {"n_views": 3, **test_transforms.BOUNDS},
    ),
    "dtu": (test_dtu.write_dtu, {"n_views": 3, "downscale": 1}),
    "blender": (
        lambda f: test_blender.write(f, opaque=True),
        {"n_views": 3, "downscale": 1, "split": "file"},
    ),
}


def write(layout: str, folder: Path, change: Mode | None = None, **save: Any) -> Path:
    """A sound scene, all photos of which are saved again under their names."""
    LAYOUTS[layout][0](folder)
    for file in folder.rglob("*.png"):
        if file.parent.name != "mask" or change is halve:
            with Image.open(file) as stored:
                stored.load()
            (change(stored) if change else stored).save(file, **save)
    return folder


def halve(image: Image.Image) -> Image.Image:
    """Reduce by 2.5."""
    return image.resize((round(image.width / 2.5), round(image.height / 2.5)))


def load(layout: str, folder: Path, **options: Any) -> Scene:
    return load_scene(layout, {"path": str(folder), **LAYOUTS[layout][1], **options})


def exif(orientation: int) -> Image.Exif:
    tags = Image.Exif()
    tags[ORIENTATION] = orientation
    return tags


@pytest.mark.parametrize("layout", LAYOUTS)
def test_photos_of_another_size_scale_the_intrinsics(layout: str, tmp_path: Path) -> None:
    sound = load(layout, write(layout, tmp_path / "scan1")).training.views[0].camera
    small = load(layout, write(layout, tmp_path / "scan2", halve)).training.views[0].camera
    assert small.width < sound.width and small.height < sound.height
    assert torch.allclose(small.K[0] / small.width, sound.K[0] / sound.width)
    if layout != "blender":  # which states an angle along x alone
        assert torch.allclose(small.K[1] / small.height, sound.K[1] / sound.height)


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("kind", ["WEBP", "TIFF", "BMP"])
def test_formats_are_read_in_every_layout(layout: str, kind: str, tmp_path: Path) -> None:
    """Whatever the suffix: names stay, so that poses find their photos."""
    sound = load(layout, write(layout, tmp_path / "scan1"))
    options = {"lossless": True} if kind == "WEBP" else {}
    as_rgb: Mode = lambda image: image.convert("RGB")  # noqa: E731
    same = load(layout, write(layout, tmp_path / "scan2", as_rgb, format=kind, **options))
    first, second = (scene.training.views[0].image for scene in (sound, same))
    assert torch.equal(first, second)


@pytest.mark.parametrize("layout", [name for name in LAYOUTS if name != "blender"])
def test_an_exif_orientation_is_applied_if_the_size_asks_for_it(
    layout: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    sound = load(layout, write(layout, tmp_path / "scan1"))
    turned = write(layout, tmp_path / "scan2", lambda i: i.rotate(90, expand=True), exif=exif(6))
    view = load(layout, turned).training.views[0]
    assert torch.equal(view.image, sound.training.views[0].image)
    assert torch.equal(view.camera.K, sound.training.views[0].camera.K)
    assert "have EXIF orientation 6, which is applied" in caplog.text


def test_pictures_that_are_not_read_are_named(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    noise_photos(tmp_path)
    (tmp_path / "n0.png").rename(tmp_path / "n0")  # is a photo all the same
    for name in ("b.dng", "c.avif", "._c.avif", "notes.txt", "d.MOV"):
        (tmp_path / name).touch()
    assert [file.name for file in list_images(tmp_path)] == ["n0", "n1.png", "n2.png"]
    assert "2 files are left out, as their format is not read: b.dng, c.avif; c" in caplog.text
    caplog.clear()
    noise_photos(tmp_path / "left")
    assert len(find_source(str(tmp_path), 1200, 40).files) == 3
    assert "3 files are left out, as their format is not read: b.dng, c.avif, d.MOV" in caplog.text
    assert "photos in its folders are left out (left); move" in caplog.text


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.png", b"GIF89a", "got GIF; convert it to JPEG or PNG"),
        ("a.jpg", b"\0\0\0\x18ftypheic", "got HEIC; convert it to JPEG or PNG"),
        (
            "a.NEF",
            b"II*\0",
            "got a RAW file \\(.nef\\); develop it",
        ),  # with a thumbnail for a reader
    ],
)
def test_other_formats_are_named(name: str, content: bytes, message: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(UserError, match=message):
        read_image(tmp_path / name)


def test_no_name_leads_out_of_the_folder(tmp_path: Path) -> None:
    inner = tmp_path / "inner"
    inner.mkdir()
    for file in (tmp_path / "a.jpg", inner / "a.jpg"):
        file.touch()
    os.symlink(tmp_path / "a.jpg", inner / "link.jpg")
    for name in (str(tmp_path / "a.jpg"), "../a.jpg", "/nowhere/../a.jpg", "LINK.jpg"):
        with pytest.raises(UserError, match="expected names inside this folder"):
            find_photo(inner, name)
    for name in ("..\\a.jpg", "C:\\..\\a.jpg"):
        assert not find_photo(inner, name).exists()


@pytest.mark.parametrize("suffix", [".png", ".tif"])
@pytest.mark.parametrize("channels", [1, 3])
def test_of_16_bits_the_upper_byte_is_read(suffix: str, channels: int, tmp_path: Path) -> None:
    deep = np.arange(48 * channels, dtype=np.uint16).reshape(6, 8, channels) * 400
    cv2.imwrite(str(tmp_path / f"a{suffix}"), deep)
    expected = np.broadcast_to((deep >> 8)[..., ::-1], (6, 8, 3))
    assert np.array_equal(read_image(tmp_path / f"a{suffix}"), expected)
    cv2.imwrite(str(tmp_path / f"a{suffix}"), np.minimum(deep, 4095))
    with pytest.raises(UserError, match="as of a sensor of 12 bits; scale them"):
        read_image(tmp_path / f"a{suffix}")
