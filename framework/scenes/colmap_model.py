"""A COLMAP sparse model as lenses, poses and tracks, and the choice among several models."""

import logging
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from framework.errors import UserError, require
from framework.files.opened import is_file
from framework.files.paths import inside
from framework.scenes.assemble import Tracks
from framework.scenes.cameras import checked_lens, checked_pose
from framework.scenes.colmap_files import MODELS, Camera, read_files
from framework.scenes.coloured import read_coloured
from framework.scenes.images import AUTO
from framework.scenes.lens import Distortion, Lens

log = logging.getLogger(__name__)

PLY = "points3D.ply"  # written in place of points3D.bin by MASt3R's and other exports
NOT_UNIT = 1e-2  # largest deviation of a quaternion's length from 1; below, it is normalised
ROUNDED = 1e-12  # deviation of a unit quaternion's length by rounding
SUPPORTED = ("PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV")


@dataclass(frozen=True)
class Model:
    """Registered images sorted by name, a lens and [4, 4] world-to-camera of each; the tracks."""

    names: list[str]
    lenses: list[Lens]
    viewmats: list[NDArray[np.float64]]
    tracks: Tracks


def model_folders(folder: Path) -> list[Path]:
    """List the folders of COLMAP models in a scene: of `sparse` and nerfstudio's `colmap/sparse`
    their folders by number, then they themselves; last the scene's own."""
    candidates = []
    for root in (folder / "sparse", folder / "colmap" / "sparse"):
        folders = [path for path in root.iterdir() if path.is_dir()] if root.is_dir() else []
        candidates += [*sorted(folders, key=lambda path: (len(path.name), path.name)), root]
    names = [f"{stem}{suffix}" for stem in ("cameras", "images") for suffix in (".bin", ".txt")]
    return [path for path in (*candidates, folder) if any(is_file(path / n) for n in names)]


def choose_model(
    folder: Path, model: str, count_photos: Callable[[Model], int]
) -> tuple[Path, Model] | None:
    """Read the COLMAP model that has poses for the most photos, the first one if several do.

    Args:
        folder: the scene.
        model: `scene.model`: a model's folder inside the scene's, or "auto".
        count_photos: number of the scene's photos that a model has poses for.

    Returns:
        The model and its folder; None if the scene has none.

    Raises:
        UserError: the model, or each of several ones, is damaged or unsupported.
    """
    if model != AUTO:
        path = inside(folder, model)
        return path, read_model(path)
    models, counts, errors = {}, {}, []
    for path in model_folders(folder):
        try:
            models[path] = read_model(path)
            counts[path] = count_photos(models[path])
        except UserError as error:
            models.pop(path, None)
            errors.append((path, error))
    if not models and errors:
        raise errors[0][1]
    if not models:
        return None
    best = max(models, key=lambda path: counts[path])
    others = [
        f"{path.relative_to(folder)} ({n} photos)" for path, n in counts.items() if path != best
    ]
    others += [f"{path.relative_to(folder)} ({error})" for path, error in errors]
    if others:
        log.warning(
            f"{folder}: of {len(others) + 1} COLMAP models {best.relative_to(folder)} is used, with"
            f" poses of {counts[best]} photos, and not {', '.join(others)}; scene.model=FOLDER"
            " chooses another"
        )
    return best, models[best]


def read_model(folder: Path) -> Model:
    """Read the model in `folder`.

    Raises:
        UserError: for missing, damaged or unsupported files.
    """
    cameras, images, tracks = read_files(folder)
    require(len(images) > 0, f"{folder}: expected images with poses, got none; rebuild the model")
    used = {image.camera for image in images}  # others may have models that are not supported
    lenses = {i: _lens(cameras[i], folder) for i in used}
    if not len(tracks.xyz) and is_file(folder / PLY):
        tracks = read_coloured(inside(folder, PLY), len(images))
    return Model(
        names=[image.name for image in images],
        lenses=[lenses[image.camera] for image in images],
        viewmats=[_viewmat(image.pose, f"{folder}: image {image.name}") for image in images],
        tracks=tracks,
    )


def _lens(camera: Camera, folder: Path) -> Lens:
    where = f"{folder}: camera {camera.id}"
    require(
        camera.model in SUPPORTED,
        f"{where}: expected a camera model among {', '.join(SUPPORTED)}, got {camera.model[:40]};"
        " undistort with `colmap image_undistorter` first",
    )
    count = MODELS[camera.model]
    require(
        len(camera.params) == count,
        f"{where}: expected {count} parameters, got {len(camera.params)}; rebuild the model",
    )
    two_focals = camera.model in ("PINHOLE", "OPENCV", "FULL_OPENCV")
    # after focal lengths and principal point come coefficients in the order of Distortion's fields
    fx, fy, cx, cy, *coefficients = (
        camera.params if two_focals else camera.params[:1] + camera.params
    )
    lens = Lens(camera.width, camera.height, fx, fy, cx, cy, Distortion(*coefficients))
    return checked_lens(lens, where)


def _viewmat(pose: Sequence[float], where: str) -> NDArray[np.float64]:
    """[4, 4] world-to-camera of a quaternion wxyz and a translation."""
    length = math.hypot(*pose[:4])
    require(
        abs(length - 1.0) <= NOT_UNIT,  # false for NaN too
        f"{where}: expected a rotation, a quaternion of length 1 (within {NOT_UNIT:g}), got length"
        f" {length:.4g}; rebuild the model",
    )
    require(
        abs(length - 1.0) <= NOT_UNIT,  # false for NaN too
        f"{where}: expected a rotation, a quaternion of length 1 (within {NOT_UNIT:g}), got length"
        f" {length:.4g}; rebuild the model",
    )
    scale = length if abs(length - 1) > ROUNDED else 1.0  # COLMAP uses unit quaternions as they are
    w, x, y, z = (value / scale for value in pose[:4])
    viewmat = np.eye(4)
    viewmat[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    viewmat[:3, 3] = pose[4:]
    return checked_pose(viewmat, where)
