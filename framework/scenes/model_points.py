"""The sparse points of a COLMAP model for a scene whose poses come from another file."""

import logging
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath

import numpy as np
from numpy.typing import NDArray

from framework.compute.elementary import product
from framework.errors import UserError
from framework.scenes.assemble import Tracks
from framework.scenes.cameras import center_of
from framework.scenes.colmap_model import Model, choose_model
from framework.scenes.images import AUTO

log = logging.getLogger(__name__)

SAME_POSE = 0.01  # distance between two models' camera centres, of the rig's size


def moved(xyz: NDArray[np.float64], world: NDArray[np.float64]) -> NDArray[np.float64]:
    """[M, 3] points after a [4, 4] transform."""
    return product(xyz, world[:3, :3].T) + world[:3, 3]


@dataclass(frozen=True)
class _Fit:
    """A comparison of a model with the poses of the photos.

    Attributes:
        columns: [n] index of each photo's image in the model, -1 without one.
        away: largest distance of two paired camera centres.
        size: radius of the rig.
        world: [4, 4] from the model's world.
    """

    columns: NDArray[np.intp]
    away: float
    size: float
    world: NDArray[np.float64]

    @property
    def photos(self) -> int:
        """Number of photos with the same position in the model; 0 if any differs."""
        pairs = int((self.columns >= 0).sum())
        return pairs if pairs > 1 and self.away <= SAME_POSE * self.size else 0


def colmap_tracks(
    folder: Path,
    source: str,
    names: Sequence[str],
    viewmats: Sequence[NDArray[np.float64]],
    model: str = AUTO,
    worlds: Sequence[NDArray[np.float64]] = (np.eye(4),),
) -> Tracks:
    """Read the points of the scene's COLMAP model that has the poses of the photos.

    Args:
        folder: the scene.
        source: of the poses, for messages.
        names: the photos in sorted order. Names in the model may differ if it has as many images.
        viewmats: [4, 4] world-to-camera of each photo.
        model: `scene.model`.
        worlds: [4, 4] transforms to try, from the model's world to that of the poses.

    Returns:
        The points with tracks over the photos; no points without a model.

    Raises:
        UserError: the model has other poses.
    """

    def fit(model: Model) -> _Fit:
        fits = [f for world in worlds for f in _fits(model, names, viewmats, world)]
        return max(fits, key=lambda f: f.photos)

    chosen = choose_model(folder, model, lambda m: fit(m).photos)
    if chosen is None:
        return Tracks()
    path, read = chosen
    best = fit(read)
    if best.photos:
        tracks = read.tracks.of_images(best.columns.tolist())
        unmoved = bool((best.world == np.eye(4)).all())
        return tracks if unmoved else replace(tracks, xyz=moved(tracks.xyz, best.world))
    error = UserError(
        f"{path}: expected the poses of {source} ({len(names)} images), got {len(read.names)}"
        f" images, {int((best.columns >= 0).sum())} of them with the same names, camera centres up"
        f" to {best.away:.3g} away (rig radius {best.size:.3g}); remove the folder or rebuild the"
        " model with these poses"
    )
    if folder / "colmap" not in path.parents:
        raise error
    log.warning(f"{error}; its points are not used")  # nerfstudio may have changed the poses since
    return Tracks()


def same_poses(
    folder: Path, viewmats: Sequence[NDArray[np.float64]], model: str = AUTO
) -> list[str] | None:
    """Names of the images of a COLMAP model that has these poses in this order; None without it."""
    names = [""] * len(viewmats)  # no name matches
    chosen = choose_model(folder, model, lambda m: _fits(m, names, viewmats, np.eye(4))[0].photos)
    fits = _fits(chosen[1], names, viewmats, np.eye(4)) if chosen else []
    return chosen[1].names if chosen and fits[0].photos else None


def _fits(
    model: Model,
    names: Sequence[str],
    viewmats: Sequence[NDArray[np.float64]],
    world: NDArray[np.float64],
) -> list[_Fit]:
    """Pair the photos with the model's images in order, if there are as many, and by name."""
    ours = np.array([center_of(v) for v in viewmats])
    theirs = moved(np.array([center_of(v) for v in model.viewmats]), world)
    size = float(np.linalg.norm(ours - ours.mean(axis=0), axis=1).max())
    pairings = [np.arange(len(ours))] if len(ours) == len(theirs) else []
    pairings.append(_same_names(model.names, names))
    fits = []
    for columns in pairings:
        pairs = columns >= 0
        apart = np.linalg.norm(theirs[columns[pairs]] - ours[pairs], axis=1)
        fits.append(_Fit(columns, float(apart.max(initial=0.0)), size, world))
    return fits


def _same_names(listed: Sequence[str], names: Sequence[str]) -> NDArray[np.intp]:
    """[n] index in `listed` of the image with the stem of each name, -1 without a single one."""
    theirs, ours = ([PurePosixPath(name).stem for name in these] for these in (listed, names))
    once = [{s for s, times in Counter(stems).items() if times == 1} for stems in (theirs, ours)]
    index = {stem: i for i, stem in enumerate(theirs) if stem in once[0] & once[1]}
    return np.array([index.get(stem, -1) for stem in ours], dtype=np.intp)
