"""The chosen model as it is kept: upright, with the photos' own names, and only the placed ones."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from framework.scenes.photos.attempt import Attempt
from framework.scenes.photos.prepare import Photo

if TYPE_CHECKING:
    from numpy.typing import NDArray


def store(chosen: Attempt, photos: Sequence[Photo], folder: Path) -> None:
    """Write `sparse/0`, and name the files of `images` as the photos are called.

    They move from one folder to another: a photo may be called as the prepared one of another is.
    """
    import pycolmap

    model = chosen.model
    shown = {photo.stored: photo.name for photo in photos}
    views = [model.image(i).cam_from_world().matrix() for i in sorted(model.reg_image_ids())]
    turn, center = upright(np.array(views))
    model.transform(pycolmap.Sim3d(1.0, pycolmap.Rotation3d(turn), -turn @ center))
    for image in model.images.values():
        image.name = shown[image.name]
    sparse = folder / "sparse" / "0"
    sparse.mkdir(parents=True)
    model.write_binary(sparse)
    prepared = folder / "prepared"
    (folder / "images").rename(prepared)
    (folder / "images").mkdir()
    for stored, name in shown.items():
        if name in chosen.placed:
            (prepared / stored).rename(folder / "images" / name)
    shutil.rmtree(prepared)


def upright(views: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(rotation [3, 3], centre [3]) of the world in which the cameras, world-to-camera [n, 3, 4],
    stand around the origin, down is +y and their mean view, as far as it is level, +z.

    A structure from motion has no up of its own. Photos are mostly held level, so the mean of what
    is down in them is; viewers that open the splat then show it so.
    """
    rotations = views[:, :, :3]
    center = -np.einsum("nij,ni->nj", rotations, views[:, :, 3]).mean(axis=0)
    down = rotations[:, 1].mean(axis=0)
    if np.linalg.norm(down) < 0.1:  # held every way: no down
        down = rotations[0, 1]
    y = down / np.linalg.norm(down)
    ahead = rotations[:, 2].mean(axis=0)
    level = ahead - (ahead @ y) * y
    if np.linalg.norm(level) < 0.01:  # cameras all around, or all looking down
        level = np.cross(rotations[0, 0], y)
    z = level / np.linalg.norm(level)
    return np.stack([np.cross(y, z), y, z]), center
