"""Coloured points without tracks, from a PLY file."""

from pathlib import Path

import numpy as np

from framework.errors import require
from framework.files.limits import MODEL_CELLS
from framework.files.ply import read_commented
from framework.scenes.assemble import Tracks
from framework.scenes.cameras import near_points

COLUMNS = ("x", "y", "z", "red", "green", "blue")


def read_coloured(path: Path, images: int) -> Tracks:
    """Read points with uchar colours.

    Args:
        images: number of images that `Tracks.seen` is over.

    Raises:
        UserError: if the file lacks them, or has too many.
    """
    vertices, _ = read_commented(path)
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
    cells = int(good.sum()) * images
    require(
        cells <= MODEL_CELLS,
        f"points: expected at most {MODEL_CELLS:,} points x images, got {cells:,}; thin out the"
        " points",
    )
    return Tracks(xyz[good], rgb[good], np.zeros((int(good.sum()), images), dtype=bool))
