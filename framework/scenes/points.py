"""The sparse points for training, and the depth bounds from them.

Points with tracks, as of a COLMAP model, need two training views in their track (see
`assemble.Tracks.for_training`). Points without tracks, as of a PLY file, a scanner or a network,
are seen by the training views that they project into. Without any points, they are triangulated
from the training photos.
"""

import logging
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from framework.compute.elementary import product
from framework.errors import require
from framework.scenes.assemble import Shot, Tracks
from framework.scenes.triangulate import triangulate

MOST_BEHIND = 0.2  # share of points behind the cameras that see them

log = logging.getLogger(__name__)

FEWEST = 20  # points for reliable bounds
PERCENTILES = (0.1, 99.9)  # of the depths, as LLFF's poses_bounds.npy has them
POINTS_PER_CELL = 4  # of the grid in which near points hide far ones
MOST = 200_000  # points without tracks
CORRELATION = 0.1  # of colours: 0.5 to 0.9 for the open scenes, below 0.1 in another world
HIDDEN = 1.5  # times the depth of the nearest point in its cell; deeper points are hidden


def points_and_bounds(
    tracks: Tracks,
    viewmats: Sequence[NDArray[np.float64]],
    train: Sequence[int],
    shots: Sequence[Shot],
    near: float | None,
    far: float | None,
    where: str,
) -> tuple[Tracks, float, float]:
    """Choose the training views' points and the depth bounds.

    Args:
        tracks: points, `seen` over all photos; may be empty.
        viewmats: [4, 4] world-to-camera of all photos.
        train: indices of the training views.
        shots: the training views.
        near: `scene.near`, None if it is not set.
        far: `scene.far`, None if it is not set.
        where: starts a message.

    Returns:
        The points that at least two training views see, near and far. If no training view sees a
        point and a bound is not set, points are triangulated from the training views.

    Raises:
        UserError: a bound is not set, and there are too few points to find it.
    """
    tracks = see_untracked(tracks, train, shots, where)
    if near is None or far is None:
        if not len(tracks.xyz) or not tracks.seen[:, list(train)].any():
            tracks = triangulate(shots, where)
            viewmats, train = [shot.viewmat for shot in shots], range(len(shots))
        bounds = depth_bounds(tracks, viewmats, train, where)
        near, far = near or bounds[0], far or bounds[1]
        require(
            near < far,
            f"{where}: expected near < far, got near={near:.4g}, far={far:.4g} (one of them from"
            " the points); give both",
        )
    return tracks.for_training(train), near, far


def see_untracked(
    tracks: Tracks, train: Sequence[int], shots: Sequence[Shot], where: str
) -> Tracks:
    """Make points without a track visible to the training views that they project into.

    If no track has more than one image, as of networks that predict a depth per image, the tracks
    only name the images that the points come from. Points of training views then count as without
    a track. Of more than `MOST` points every k-th is used. Logs a warning, as points of unknown
    origin may contain information of test photos. Points whose colours do not match the photos, as
    of another world than the poses', are left out with a warning.
    """
    images = tracks.seen.sum(axis=1)
    chosen = images == 0
    if len(images) and images.max() == 1:
        chosen |= tracks.seen[:, list(train)].any(axis=1)
    if not chosen.any():
        return tracks
    index = np.flatnonzero(chosen)
    chosen[:] = False
    chosen[index[:: -(-len(index) // MOST)]] = True
    xyz, rgb = tracks.xyz[chosen], tracks.rgb[chosen]
    pixels = [_project(shot, xyz) for shot in shots]
    visible = [_visible(shot, *uvz) for shot, uvz in zip(shots, pixels, strict=True)]
    if not _same_colours(rgb, shots, pixels, visible):
        log.warning(
            f"{where}: {len(xyz)} sparse points without tracks are left out, as their colours do"
            " not match the training photos; bring them into the world of the poses"
        )
        return Tracks(tracks.xyz[~chosen], tracks.rgb[~chosen], tracks.seen[~chosen])
    seen = tracks.seen.copy()
    seen[np.ix_(chosen, train)] = np.stack(visible, axis=1)
    log.warning(
        f"{where}: {len(xyz)} sparse points have no track of several photos, so they count as seen"
        " by the training photos that they project into; if test photos took part in making them,"
        " test scores are too high"
    )
    return Tracks(tracks.xyz, tracks.rgb, seen)


Pixels = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]


def _project(shot: Shot, xyz: NDArray[np.float64]) -> Pixels:
    """Pixel coordinates u and v, 0 behind the camera, and depth z of [M, 3] points."""
    seen = product(xyz, shot.viewmat[:3, :3].T) + shot.viewmat[:3, 3]
    u, v, z = product(seen, shot.K.T).T
    ahead = np.where(z > 0, z, np.inf)
    return u / ahead, v / ahead, z


def _visible(
    shot: Shot, u: NDArray[np.float64], v: NDArray[np.float64], z: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """[M] whether each point is in the image, and not far behind the nearest one in its cell."""
    height, width = shot.image.shape[:2]
    visible = (z > 0) & (u >= 0) & (u < width) & (v >= 0) & (v < height)
    z = z[visible]
    side = max(1.0, (width * height * POINTS_PER_CELL / max(len(z), 1)) ** 0.5)
    row, column = ((values[visible] // side).astype(np.intp) for values in (v, u))
    cell = row * int(width // side + 1) + column
    nearest = np.full(int(cell.max(initial=0)) + 1, np.inf)
    np.minimum.at(nearest, cell, z)
    visible[visible] = z < HIDDEN * nearest[cell]
    return visible


def _same_colours(
    rgb: NDArray[np.uint8],
    shots: Sequence[Shot],
    pixels: Sequence[Pixels],
    visible: Sequence[NDArray[np.bool_]],
) -> bool:
    """Whether the grey values of points correlate with those of their pixels. Too few points, or
    points of one colour, pass if any is visible."""
    theirs, ours = [np.zeros(0)], [np.zeros(0)]
    for shot, (u, v, _), seen in zip(shots, pixels, visible, strict=True):
        theirs.append(rgb[seen].mean(axis=1))
        ours.append(shot.image[v[seen].astype(int), u[seen].astype(int)].mean(axis=1))
    a, b = (np.concatenate(values) for values in (theirs, ours))
    if len(a) < FEWEST or a.std() * b.std() == 0:
        return len(a) > 0
    return float(np.corrcoef(a, b)[0, 1]) > CORRELATION


def depth_bounds(
    tracks: Tracks, viewmats: Sequence[NDArray[np.float64]], train: Sequence[int], where: str
) -> tuple[float, float]:
    """(near, far): 0.1 and 99.9 percentiles of the depths in the training views of points that at
    least two of them see.

    Other points were found with the help of test photos. They count only if the training views
    share fewer than `FEWEST`, with a warning.

    Raises:
        UserError: without any points.
    """
    shared = tracks.for_training(train)
    counted = int(tracks.seen[:, list(train)].any(1).sum())
    if len(shared.xyz) >= min(FEWEST, counted) > 0:
        tracks, viewmats, train = shared, [viewmats[i] for i in train], range(len(train))
    else:
        log.warning(
            "%s: the training photos share %d sparse points, too few for near and far; points that"
            " they share with test photos count too",
            where,
            len(shared.xyz),
        )
    depths = []
    for i in train:
        xyz, viewmat = tracks.xyz[tracks.seen[:, i]], viewmats[i]
        depths.append(product(xyz, viewmat[2, :3]) + viewmat[2, 3])
    z = np.concatenate(depths)
    require(
        len(z) > 0,
        f"{where}: expected 3D points seen by the training views, got none, so that"
        " depth bounds are unknown; triangulate points or choose other views",
    )
    behind = float((z <= 0).mean())
    misfit = f"{behind:.0%} of the points lie behind the cameras that see them, so the poses do not"
    advice = "fit the points; if they are written in another convention, set scene.poses"
    require(behind < 1, f"{where}: {misfit} {advice}")
    if behind > MOST_BEHIND:
        log.warning("%s: %s seem to %s", where, misfit, advice)
    near, far = np.percentile(z[z > 0], PERCENTILES)
    return float(near), float(max(far, near * (1 + 1e-6)))
