"""A COLMAP sparse model (bin or txt) as arrays, read by pycolmap after its files were checked.

pycolmap 4.0 reads past the end of truncated binaries (a cut cameras.bin gives wrong numbers, a cut
points3D.bin never ends), hence `colmap_files.check`.
"""

from __future__ import annotations

import logging
import signal
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from framework.errors import UserError, require
from framework.files.limits import MODEL_BYTES, MODEL_CELLS
from framework.files.opened import is_file, read_bytes
from framework.files.paths import inside
from framework.scenes import colmap_files
from framework.scenes.assemble import Tracks, untracked
from framework.scenes.cameras import checked_lens, checked_pose, near_points
from framework.scenes.colmap_text import read_lines
from framework.scenes.lens import Distortion, Lens
from framework.scenes.options import AUTO
from framework.scenes.ply_vertices import read_coloured

log = logging.getLogger(__name__)

PLY = "points3D.ply"  # written in place of points3D.bin by MASt3R's and other exports
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


def _lens(camera: Any, where: Path) -> Lens:
    """The lens of a pycolmap camera. Raises UserError for a model that is not supported."""
    name = camera.model.name
    require(
        name in SUPPORTED,
        f"{where}: expected a camera model among {', '.join(SUPPORTED)}, got {name} (camera"
        f" {camera.camera_id}); undistort with `colmap image_undistorter` first",
    )
    p = [float(v) for v in camera.params]
    two_focals = name in ("PINHOLE", "OPENCV", "FULL_OPENCV")
    fx, fy, cx, cy = p[:4] if two_focals else (p[0], p[0], p[1], p[2])
    # after these come the model's coefficients, in the order of Distortion's fields
    distortion = Distortion(*p[4 if two_focals else 3 :])
    lens = Lens(camera.width, camera.height, fx, fy, cx, cy, distortion)
    return checked_lens(lens, f"{where}: camera {camera.camera_id}")


def _viewmat(image: Any, where: Path) -> NDArray[np.float64]:
    viewmat = np.eye(4)
    viewmat[:3] = np.asarray(image.cam_from_world().matrix(), dtype=np.float64)
    return checked_pose(viewmat, f"{where}: image {image.name}")


def _tracks(points: dict[int, Any], column: dict[int, int], where: Path) -> Tracks:
    """column: image id -> index of its sorted name. Points in the order of their ids."""
    ids = sorted(points)
    cells = len(ids) * len(column)
    require(
        cells <= MODEL_CELLS,
        f"{where}: expected at most {MODEL_CELLS:,} points x images, got {cells:,}; filter the"
        " points or split the model",
    )
    seen = np.zeros((len(ids), len(column)), dtype=bool)
    for row, point_id in enumerate(ids):
        for element in points[point_id].track.elements:
            seen[row, column[element.image_id]] = True
    xyz = np.array([points[i].xyz for i in ids], dtype=np.float64).reshape(-1, 3)
    rgb = np.array([points[i].color for i in ids], dtype=np.uint8).reshape(-1, 3)
    good = near_points(xyz)
    return Tracks(xyz[good], rgb[good], seen[good])


def _pycolmap() -> Any:
    """The module, without the handler it installs: a run that is told to end, as by a cluster's
    time limit, would print the stack of its C++ code."""
    before = signal.getsignal(signal.SIGTERM)
    import pycolmap

    if threading.current_thread() is threading.main_thread():  # no other one may
        signal.signal(signal.SIGTERM, before)
    return pycolmap


@contextmanager
def _quiet(pycolmap: Any) -> Iterator[None]:
    """Keep pycolmap's own log lines off the screen: the UserError says it in one."""
    before = pycolmap.logging.minloglevel
    pycolmap.logging.minloglevel = pycolmap.logging.FATAL.value
    try:
        yield
    finally:
        pycolmap.logging.minloglevel = before


def _reconstruction(folder: Path) -> Any:
    """pycolmap's reading of the checked cameras, images and points3D. Newer models also have rigs
    and frames, which repeat the poses and cannot be checked: a copy without them is read."""
    files, names = colmap_files.check(folder)
    pycolmap = _pycolmap()
    with tempfile.TemporaryDirectory() as copy, _quiet(pycolmap):
        for file in files:
            text = names and read_lines(file)  # pycolmap reads no byte order mark
            content = text.encode() if text else read_bytes(file, MODEL_BYTES)
            (Path(copy) / file.name).write_bytes(content)
        if len(files) < len(colmap_files.STEMS):
            binary = files[0].suffix == ".bin"
            (Path(copy) / f"points3D{files[0].suffix}").write_bytes(bytes(8) if binary else b"")
        try:
            model = pycolmap.Reconstruction(copy)
        except (ValueError, IndexError, RuntimeError, OSError, KeyError) as error:
            reason = " ".join(str(error).split())[:120]
            raise UserError(
                f"{folder}: expected a readable COLMAP model, got damaged files ({reason});"
                " rebuild it"
            ) from None
    for image, name in names.items():
        model.image(image).name = name
    return model


def read_model(folder: Path) -> Model:
    """The model in `folder`. Raises UserError for missing, damaged or unsupported files."""
    model = _reconstruction(folder)
    images = sorted((model.image(i) for i in model.reg_image_ids()), key=lambda image: image.name)
    require(len(images) > 0, f"{folder}: expected images with poses, got none; rebuild the model")
    used = {image.camera_id for image in images}  # another may be of a kind that is not read
    lenses = {i: _lens(camera, folder) for i, camera in model.cameras.items() if i in used}
    tracks = _tracks(dict(model.points3D), {im.image_id: k for k, im in enumerate(images)}, folder)
    if not len(tracks.xyz) and is_file(folder / PLY):
        xyz, rgb = read_coloured(inside(folder, PLY))
        tracks = untracked(xyz, rgb, len(images))
    return Model(
        names=[image.name for image in images],
        lenses=[lenses[image.camera_id] for image in images],
        viewmats=[_viewmat(image, folder) for image in images],
        tracks=tracks,
    )
