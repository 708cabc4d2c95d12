"""The LLFF loader: conventions by hand, agreement with COLMAP, and every error."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from framework.errors import UserError
from framework.types import Scene
from tests.built import load_scene
from tests.data import open_scene
from tests.scenes.synthetic import FOCAL, HEIGHT, WIDTH, llff_rows, write_llff, write_model


def load(folder: Path, **options: object) -> Scene:
    return load_scene("llff", {"path": str(folder), **options})


def test_axes_intrinsics_and_bounds(tmp_path: Path) -> None:
    scene = load(write_llff(tmp_path))
    view = scene.training.views[0]
    assert [v.name for v in scene.training.views] == ["im01.png", "im05.png", "im09.png"]
    assert [v.name for v in scene.test] == ["im00.png", "im08.png"]
    expected = torch.eye(4, dtype=torch.float64)
    expected[0, 3] = -0.1
    assert torch.equal(view.camera.viewmat, expected)
    K = [[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]]
    assert view.camera.K.tolist() == K
    assert (view.camera.width, view.camera.height) == (WIDTH, HEIGHT)
    # training rows only: the smallest near bound belongs to test image 0
    assert scene.training.near == pytest.approx(2.1)
    assert scene.training.far == pytest.approx(9.9)
    assert len(scene.training.points.xyz) == 0
    assert scene.training.points.visible.shape == (0, 3)


def test_fern_split_and_agreement_with_its_colmap_model() -> None:
    folder = open_scene("llff_fern")
    scene = load(folder)
    assert [v.name for v in scene.training.views] == [f"image{i:03d}.png" for i in (1, 10, 19)]
    assert [v.name for v in scene.test] == [f"image{i:03d}.png" for i in (0, 8, 16)]
    twin = load_scene("colmap", {"path": str(folder), "n_views": 3})
    for a, b in zip(
        (*scene.training.views, *scene.test), (*twin.training.views, *twin.test), strict=True
    ):
        assert torch.allclose(a.camera.viewmat, b.camera.viewmat, atol=1e-5)
        assert torch.allclose(a.camera.K, b.camera.K, atol=1e-3)
        assert torch.equal(a.image, b.image)
    assert torch.equal(scene.training.points.xyz, twin.training.points.xyz)


def test_fern_never_offers_points_of_test_tracks_only() -> None:
    """Points with at most one training view in the track are removed from the 2912."""
    from framework.scenes.colmap_model import read_model

    folder = open_scene("llff_fern")
    model = read_model(folder / "sparse" / "0")
    train = [1, 10, 19]
    forbidden = model.tracks.xyz[model.tracks.seen[:, train].sum(axis=1) < 2]
    inputs = {tuple(p) for p in load(folder).training.points.xyz.tolist()}
    assert len(forbidden) > 1000
    assert not inputs & {tuple(p) for p in forbidden.tolist()}


def _no_images(folder: Path) -> None:
    for file in (folder / "images_8").iterdir():
        file.unlink()


def _save(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Path], None]:
    return lambda folder: np.save(folder / "poses_bounds.npy", change(llff_rows()))


def _with(row: int, column: int, value: float) -> Callable[[Path], None]:
    def change(rows: np.ndarray) -> np.ndarray:
        rows[row, column] = value
        return rows

    return _save(change)


def _small_image(folder: Path) -> None:
    Image.new("RGB", (25, 15)).save(folder / "images_8" / "im05.png")


def _model_of_others(folder: Path) -> None:
    write_model(folder / "sparse/0", 9, [])
    images = folder / "sparse/0/images.txt"
    images.write_text(images.read_text().replace(" im", " IMG_"))


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (_no_images, "images_8: expected a folder of .*images, got no image in it"),
        (_small_image, r"im05.png: expected the camera's 320x240 .*, got 25x15"),
        (lambda f: (f / "poses_bounds.npy").unlink(), "expected LLFF poses, found no file"),
        (_save(lambda r: r[:9]), "got 9 rows and 10 images"),
        (_with(3, 2, np.nan), r"expected finite numbers, .* rows \[3\]"),
        (_with(5, 16, np.inf), r"expected finite numbers, .* rows \[5\]"),
        (_with(4, 15, 20.0), r"expected .*0 < near < far.* rows \[4\]"),
        (_with(4, 0, 0.5), "orthonormal camera axes"),
        (_model_of_others, r"\(10 images\), got 9 images, 0 of them with the same names"),
        (lambda f: write_model(f / "sparse/0", 10, [], center_step=0.2), "camera centres up to"),
    ],
)
def test_damaged_folders(tmp_path: Path, damage: Callable[[Path], None], message: str) -> None:
    damage(write_llff(tmp_path))
    with pytest.raises(UserError, match=message) as caught:
        load(tmp_path)
    assert "\n" not in str(caught.value)


def test_numbers_in_another_order_than_the_names(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    folder = write_llff(tmp_path)
    load(folder)
    assert not caplog.text
    for i in range(10):
        (folder / f"images_8/im{i:02d}.png").rename(folder / f"images_8/x{i + 4}.png")
    load(folder)
    assert "in which x10.png comes before x4.png; if the poses are in the order" in caplog.text
