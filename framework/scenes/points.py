"""Where a scene's sparse points come from, and the depth bounds they give.

Points of a COLMAP model have tracks, so those that too few training views support are left out (see
`assemble.Tracks.for_training`). A PLY file has none: it is taken only when the user names it.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from framework.compute import portable
from framework.errors import UserError, require
from framework.files.opened import is_file
from framework.scenes.assemble import Tracks
from framework.scenes.cameras import near_points
from framework.scenes.ply_vertices import read_vertices

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from framework.scenes.assemble import Shot

log = logging.getLogger(__name__)

SAME_POSE = 0.01  # distance between two models' camera centres, of the rig's size
COLUMNS = ("x", "y", "z", "red", "green", "blue")  # of a PLY file
FEWEST = 20  # points to know bounds from
PERCENTILES = (0.1, 99.9)  # of the depths, as LLFF's poses_bounds.npy has them


def center_of(viewmat: NDArray[np.float64]) -> NDArray[np.float64]:
    """[3] camera centre of a [4, 4] world-to-camera."""
    return -portable.product(viewmat[:3, :3].T, viewmat[:3, 3])


def colmap_tracks(
    folder: Path, source: str, names: Sequence[str], viewmats: Sequence[NDArray[np.float64]]
) -> Tracks:
    """The points of `folder/sparse/0` with their tracks over the (sorted) images `names`; none
    without such a model. `source` names what the poses are from.

    Raises UserError unless the model has as many images at the same places; names may differ.
    """
    from framework.scenes.colmap_model import read_model

    sparse = folder / "sparse" / "0"
    if not sparse.is_dir():
        return Tracks()
    model = read_model(sparse)
    require(
        len(model.names) == len(names),
        f"{sparse}: expected the {len(names)} images of {source}, got {len(model.names)};"
        " remove the folder (then there are no sparse points) or rebuild the model",
    )
    theirs = np.array([center_of(v) for v in model.viewmats])
    ours = np.array([center_of(v) for v in viewmats])
    size = np.linalg.norm(ours - ours.mean(axis=0), axis=1).max()
    away = np.linalg.norm(theirs - ours, axis=1).max()
    require(
        away <= SAME_POSE * size,
        f"{sparse}: expected the poses of {source}, got camera centres up to {away:.3g}"
        f" away (rig radius {size:.3g}); remove the folder or rebuild the model with these poses",
    )
    return model.tracks


def ply_points(path: Path, shots: Sequence[Shot]) -> Tracks:
    """The points (x, y, z and uchar red, green, blue) of a PLY file that at least two of the
    training `shots` have in their image; `seen` says so, occlusion unknown.

    Raises UserError for a file that is no such PLY.
    """
    xyz, rgb = _read_ply(path)
    seen = np.stack([_in_image(shot, xyz) for shot in shots], axis=1)
    return Tracks(xyz, rgb, seen).for_training(range(len(shots)))


def _read_ply(path: Path) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    require(
        is_file(path),
        f"{path}: expected a PLY file of coloured points, found none; correct scene.points",
    )
    vertices = read_vertices(path)
    lacks = [name for name in COLUMNS if name not in (vertices.dtype.names or ())]
    require(
        not lacks,
        f"{path}: expected a PLY file of coloured points ({' '.join(COLUMNS)}), got none with"
        f" {' '.join(lacks)}; correct scene.points",
    )
    xyz = np.stack([vertices[axis].astype(np.float64) for axis in "xyz"], axis=1)
    rgb = np.stack([vertices[colour] for colour in COLUMNS[3:]], axis=1)
    require(
        rgb.dtype == np.uint8,
        f"{path}: expected colours of type uchar, got {rgb.dtype}; convert the file",
    )
    good = near_points(xyz)
    return xyz[good], rgb[good]


def _in_image(shot: Shot, xyz: NDArray[np.float64]) -> NDArray[np.bool_]:
    """[M] whether each point lies in front of the camera and inside its image."""
    seen = portable.product(xyz, shot.viewmat[:3, :3].T) + shot.viewmat[:3, 3]
    pixel = portable.product(seen, shot.K.T)
    z = pixel[:, 2]
    u, v = pixel[:, 0], pixel[:, 1]
    height, width = shot.image.shape[:2]
    return (z > 0) & (u >= 0) & (u < width * z) & (v >= 0) & (v < height * z)


def depth_bounds(
    tracks: Tracks, viewmats: Sequence[NDArray[np.float64]], train: Sequence[int], where: str
) -> tuple[float, float]:
    """(near, far): 0.1 and 99.9 percentiles of the depths at which the training views see points
    that at least two of them see.

    What a single one sees was found with the help of test photos: such points count only where the
    training views share fewer than `FEWEST`, and that is told. Raises UserError without any.
    """
    shared = tracks.for_training(train)
    counted = int(tracks.seen[:, list(train)].any(1).sum())
    if len(shared.xyz) >= min(FEWEST, counted) > 0:
        tracks, viewmats, train = shared, [viewmats[i] for i in train], range(len(train))
    else:
        log.warning(
            "%s: the training photos share %d sparse points, too few to know near and far from;"
            " points that they share with test photos count too",
            where,
            len(shared.xyz),
        )
    depths = []
    for i in train:
        xyz, viewmat = tracks.xyz[tracks.seen[:, i]], viewmats[i]
        depths.append(portable.product(xyz, viewmat[2, :3]) + viewmat[2, 3])
    z = np.concatenate(depths)
    z = z[z > 0]
    if not len(z):
        raise UserError(
            f"{where}: expected 3D points seen by the training views, got none, so that"
            " depth bounds are unknown; triangulate points or choose other views"
        )
    near, far = np.percentile(z, PERCENTILES)
    return float(near), float(max(far, near * (1 + 1e-6)))
