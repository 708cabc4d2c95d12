"""Checks of cameras, for all loaders.

A pose is a rigid motion. Focal lengths and principal point are of the order of the image. The
limits exceed any real camera; values beyond them come from a damaged or forged file, and would
cause a division by zero or meaningless numbers in a report.
"""

from collections.abc import Sequence
from dataclasses import astuple

import numpy as np
from numpy.typing import NDArray

from framework.compute.elementary import product
from framework.errors import require
from framework.files.limits import SIDE_PIXELS
from framework.scenes.lens import Lens

NOT_ROTATION = 1e-3  # largest deviation of R^T R from the identity
FARTHEST = 1e9  # scene units; float32 must hold its cube
FOCAL = (0.01, 1000.0)  # focal lengths, over the longer side of the image
OFF_CENTER = 10.0  # offset of the principal point from the middle, over the longer side
CORNER = 0.2  # offset of another size's principal point, over both sides of the photo
OUTSIDE = 1.0  # offset over one side of the photo, half a side beyond its edge
BENT = 100.0  # largest coefficient of a lens distortion
ROUNDED = 0.5  # pixels; largest error of a visible point in float32
ASTRAY = 1000.0  # times the rig's size and the far bound; farther cameras see nothing


def center_of(viewmat: NDArray[np.float64]) -> NDArray[np.float64]:
    """[3] camera centre of a [4, 4] world-to-camera."""
    return -product(viewmat[:3, :3].T, viewmat[:3, 3])


def checked_pose(viewmat: NDArray[np.float64], where: str) -> NDArray[np.float64]:
    """Return the [4, 4] world-to-camera.

    Raises:
        UserError: unless it is a rigid motion.
    """
    rotation = viewmat[:3, :3]
    with np.errstate(over="ignore", invalid="ignore"):
        off = float(np.abs(rotation.T @ rotation - np.eye(3)).max())
        mirrored = float(np.linalg.det(rotation)) < 0
    got = "left-handed ones" if mirrored else f"others (off by {off:.2g})"
    require(
        not mirrored and off <= NOT_ROTATION,  # false for NaN too
        f"{where}: expected right-handed, orthonormal camera axes (within {NOT_ROTATION:g}), got"
        f" {got}; scale positions, not axes",
    )
    away = float(np.abs(viewmat[:3, 3]).max())
    require(
        away <= FARTHEST,
        f"{where}: expected a camera within {FARTHEST:g} of the origin, got {away:.3g}; correct its"
        " position or scale the scene",
    )
    return viewmat


def checked_lens(lens: Lens, where: str) -> Lens:
    """Return the lens.

    Raises:
        UserError: for an impossible one.
    """
    sides = f"{lens.width}x{lens.height}"
    require(
        min(lens.width, lens.height) >= 1 and max(lens.width, lens.height) <= SIDE_PIXELS,
        f"{where}: expected sides of 1 to {SIDE_PIXELS} pixels, got {sides}; correct the camera",
    )
    longer = max(lens.width, lens.height)
    least, most = FOCAL[0] * longer, FOCAL[1] * longer
    require(
        least <= lens.fx <= most and least <= lens.fy <= most,
        f"{where}: expected positive focal lengths, {least:g} to {most:g} pixels for {sides}, got"
        f" {lens.fx:.4g} and {lens.fy:.4g}; correct the camera",
    )
    off = (lens.cx - lens.width / 2, lens.cy - lens.height / 2)
    terms = astuple(lens.distortion)
    require(
        all(abs(part) <= OFF_CENTER * longer for part in off)
        and all(abs(term) <= BENT for term in terms),
        f"{where}: expected a principal point near the image of {sides} and distortion coefficients"
        f" of at most {BENT:g}, got ({lens.cx:.4g}, {lens.cy:.4g}) and"
        f" {', '.join(f'{term:.4g}' for term in terms)}; correct the camera",
    )
    return lens


def check_size(lens: Lens, where: str) -> None:
    """Raise UserError if a lens that a file gives without its size has that of other photos.

    Intrinsics of photos k times as large have their principal point at k / 2 of both sides, towards
    a corner of these photos. Lenses are off centre by a few percent, and crops mostly along one
    side. A crop to a corner looks like another size, so its file must state the size.
    """
    off = (lens.cx / lens.width - 0.5, lens.cy / lens.height - 0.5)
    cornered = min(off) > CORNER or max(off) < -CORNER
    require(
        not cornered and max(map(abs, off)) <= OUTSIDE,
        f"{where}: expected a principal point near the middle of the photo, as the file gives no w"
        f" and h, got cx={lens.cx:.6g} and cy={lens.cy:.6g} for {lens.width}x{lens.height} pixels;"
        " add w and h, the size of the photos that cx, cy and fl_x belong to",
    )


def near_points(xyz: NDArray[np.float64]) -> NDArray[np.bool_]:
    """[M] whether each point [M, 3] is finite and within `FARTHEST` of the origin."""
    near: NDArray[np.bool_] = np.all(np.abs(xyz) <= FARTHEST, axis=1)
    return near


def check_bounds(near: float, far: float, where: str) -> None:
    """Raise UserError for invalid depth bounds."""
    require(
        1 / FARTHEST <= near < far <= FARTHEST,
        f"{where}: expected depth bounds {1 / FARTHEST:g} <= near < far <= {FARTHEST:g}, got"
        f" {near:.4g} and {far:.4g}; correct them",
    )


def check_places(
    centers: NDArray[np.float64], names: Sequence[str], far: float, where: str
) -> None:
    """Raise UserError for a camera far from all others: a test view with a wrong position would
    distort the mean of every method.

    The rig's size is the median distance to the median position, which is robust to one wrong
    position.

    Args:
        centers: [n, 3].
    """
    away = np.linalg.norm(centers - np.median(centers, axis=0), axis=1)
    most = ASTRAY * (float(np.median(away)) + far)
    farthest = int(away.argmax())
    require(
        float(away[farthest]) <= most,
        f"{where}: expected all cameras within {most:.4g} of each other (the rig's size and the far"
        f" bound, {ASTRAY:g}-fold), got {names[farthest]!r} at {away[farthest]:.4g}; correct its"
        " position or remove the photo",
    )


def check_rounding(centers: NDArray[np.float64], focal: float, near: float, where: str) -> None:
    """Raise UserError for a scene so far from the origin that float32 is too coarse for it, as with
    geographic coordinates.

    Args:
        centers: [n, 3] of the cameras.
        focal: longest focal length in pixels.
        near: depth bound.
        where: starts a message.
    """
    away = float(np.abs(centers).max()) + near
    pixels = away * float(np.finfo(np.float32).eps) * focal / near
    middle = ", ".join(f"{value:.6g}" for value in np.median(centers, axis=0))
    require(
        pixels <= ROUNDED,
        f"{where}: expected cameras near the origin, got one {away:.3g} from it, where 32-bit"
        f" numbers round what is {near:.3g} before it by {pixels:.2g} pixels; subtract ({middle})"
        " from all positions and points, or raise the near bound",
    )
