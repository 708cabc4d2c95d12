"""From arrays to a `Scene`: views, fingerprint, and the rule for sparse points.

A point reaches training only if at least two training views are in its track. A point that only
test views support would reveal what they show.
"""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from framework.errors import require
from framework.scenes.cameras import (
    center_of,
    check_bounds,
    check_places,
    check_rounding,
    checked_pose,
)
from framework.scenes.formats import listed
from framework.scenes.placement import placement

if TYPE_CHECKING:
    from framework.types import Scene, SparsePoints, View

log = logging.getLogger(__name__)

ONE_PLACE = 0.01  # of the near bound; closer cameras see no parallax
ONE_POSE = 1e-6  # of the near bound, and of an axis' length; closer cameras are the same


@dataclass(frozen=True)
class Shot:
    """One image with its camera, as arrays.

    Attributes:
        viewmat: [4, 4] world-to-camera (OpenCV axes).
        K: [3, 3] in pixels.
        image: [H, W, 3] uint8.
        depth: [H, W] float32.
        mask: [H, W] float32, 1 where pixels count; None if all do.
        lens: see `View`.
        clear: the photo was transparent and is composited over paper.
        exif: (EXIF orientation, whether it was applied) of a photo that is not stored upright,
            unless its size proves that poses ignore the orientation.
    """

    name: str
    viewmat: NDArray[np.float64]
    K: NDArray[np.float64]
    image: NDArray[np.uint8]
    depth: NDArray[np.float32] | None = None
    mask: NDArray[np.float32] | None = None
    tags: tuple[str, ...] = ()
    lens: tuple[float, ...] = ()
    clear: bool = False
    exif: tuple[int, bool] | None = None


@dataclass(frozen=True)
class Tracks:
    """Points of a sparse model.

    Attributes:
        seen: [M, n] over the n images, sorted by name.
    """

    xyz: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 3)))
    rgb: NDArray[np.uint8] = field(default_factory=lambda: np.zeros((0, 3), dtype=np.uint8))
    seen: NDArray[np.bool_] = field(default_factory=lambda: np.zeros((0, 0), dtype=bool))

    def of_images(self, columns: Sequence[int]) -> Tracks:
        """The tracks over other images, without points that lose all images but one.

        Args:
            columns: index in `seen` of each image, -1 for an image without tracks.
        """
        index = np.array(columns, dtype=np.intp)
        if not len(self.xyz):
            return Tracks(seen=np.zeros((0, len(index)), dtype=bool))
        seen = self.seen[:, index] & (index >= 0)
        left = seen.sum(axis=1)
        keep = (left >= 2) | (left == self.seen.sum(axis=1))
        return Tracks(self.xyz[keep], self.rgb[keep], seen[keep])

    def for_training(self, train: Sequence[int]) -> Tracks:
        """The points that at least two training images see; `seen` over these images."""
        if not len(self.xyz):
            return self.of_images(train)
        seen = self.seen[:, list(train)]
        keep = seen.sum(axis=1) >= 2
        return Tracks(self.xyz[keep], self.rgb[keep], seen[keep])


def intrinsics(fx: float, fy: float, cx: float, cy: float) -> NDArray[np.float64]:
    """[3, 3] pinhole matrix."""
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def _view(shot: Shot) -> View:
    import torch

    from framework.types import Camera, View

    height, width = shot.image.shape[:2]
    camera = Camera(torch.from_numpy(shot.viewmat), torch.from_numpy(shot.K), width, height)
    image = torch.from_numpy(np.ascontiguousarray(shot.image.transpose(2, 0, 1))).float() / 255
    depth = None if shot.depth is None else torch.from_numpy(shot.depth)
    mask = None if shot.mask is None else torch.from_numpy(shot.mask)
    return View(shot.name, camera, image, mask=mask, depth=depth, tags=shot.tags, lens=shot.lens)


def _check(shot: Shot) -> None:
    """Raise UserError for arrays of other shapes or types, as of a loader plugin."""
    image = shot.image
    for part, value, expected, good in (
        ("image", image, "uint8 [H, W, 3]", image.dtype == np.uint8 and image.shape[2:] == (3,)),
        ("viewmat", shot.viewmat, "[4, 4]", shot.viewmat.shape == (4, 4)),
        ("K", shot.K, "[3, 3]", shot.K.shape == (3, 3) and bool(np.isfinite(shot.K).all())),
    ):
        require(
            good,
            f"view {shot.name}: expected {part} as {expected}, got {value.dtype}"
            f" {list(value.shape)}; repair the loader",
        )
    checked_pose(shot.viewmat, f"view {shot.name}")


def _warn_of_orientations(where: str, shots: Sequence[Shot]) -> None:
    """Log a warning for each kind of EXIF orientation that may not fit the poses."""
    for orientation, applied in sorted({shot.exif for shot in shots if shot.exif is not None}):
        names = [shot.name for shot in shots if shot.exif == (orientation, applied)]
        photos = f"{len(names)} photos (first: {names[0]}) have EXIF orientation {orientation}"
        if applied:
            advice = "which is applied, as only upright they have the size of their cameras"
        else:
            advice = (
                "which is not applied: the poses must be those of the photos as stored; if they do"
                " not fit, store the photos upright"
            )
        log.warning(f"{where}: {photos}, {advice}")


def _warn_of_one_place(where: str, shots: Sequence[Shot], near: float) -> None:
    """Log a warning if all training cameras are at one place, so that nothing shows depth."""
    centers = _centers(shots)
    if len(shots) > 1 and np.linalg.norm(centers - centers[0], axis=1).max() < ONE_PLACE * near:
        log.warning(
            f"{where}: all {len(shots)} training photos are from one place, with less than"
            f" {ONE_PLACE:.0%} of the near bound between the cameras, so they show no depth; take"
            " photos from different places, a step to the side between one and the next"
        )


def _warn_of_copies(where: str, train: Sequence[Shot], test: Sequence[Shot], near: float) -> None:
    """Log a warning if training has a test photo's pixels or pose, as of a file listed twice."""
    same_pixels = {_pixels(shot): shot for shot in train}
    copies = [
        f"{shot.name} is {copied.name}"
        for shot in test
        if (copied := same_pixels.get(_pixels(shot)) or _same_pose(shot, train, near))
    ]
    if copies:
        log.warning(
            f"{where}: {len(copies)} of {len(test)} test photos have the pixels or the pose of a"
            f" training photo ({listed(copies)}), so test scores are too high; remove one of each"
        )


def _pixels(shot: Shot) -> tuple[tuple[int, ...], bytes]:
    """Equal for equal images."""
    return shot.image.shape, hashlib.sha256(shot.image.tobytes()).digest()


def _same_pose(shot: Shot, others: Sequence[Shot], near: float) -> Shot | None:
    """The first of the `others` with the camera centre and the axes of `shot`."""
    turns = np.array([other.viewmat[:3, :3] for other in others]) - shot.viewmat[:3, :3]
    away = _centers(others) - center_of(shot.viewmat)
    same = np.abs(turns).max(axis=(1, 2), initial=0) <= ONE_POSE
    same &= np.abs(away).max(axis=1, initial=0) <= ONE_POSE * near
    return others[int(same.argmax())] if same.any() else None


def _points(tracks: Tracks) -> SparsePoints:
    import torch

    from framework.types import SparsePoints

    rgb = torch.from_numpy(np.ascontiguousarray(tracks.rgb)).float() / 255
    xyz = torch.from_numpy(np.ascontiguousarray(tracks.xyz, dtype=np.float64))
    return SparsePoints(xyz, rgb, torch.from_numpy(np.ascontiguousarray(tracks.seen)))


def _centers(shots: Sequence[Shot]) -> NDArray[np.float64]:
    """[n, 3] camera centres in the world."""
    return np.array([center_of(shot.viewmat) for shot in shots]).reshape(-1, 3)


def _fingerprint(
    protocol: str,
    train: Sequence[Shot],
    test: Sequence[Shot],
    points: Tracks,
    bounds: tuple[float, float],
    paper: float | None,
    given: tuple[bool, bool],
) -> str:
    """SHA-256 over split, names, cameras, pixels, masks, depths, points, paper, near, far and which
    of the two the user gave."""
    digest = hashlib.sha256()

    def add(value: str | NDArray | None) -> None:
        if isinstance(value, np.ndarray):
            digest.update(f"{value.dtype.str}{value.shape}".encode())
            digest.update(np.ascontiguousarray(value).tobytes())
        else:
            digest.update(f"{value}\0".encode())

    add(protocol)
    for role, shots in (("train", train), ("test", test)):
        for s in shots:
            for item in (role, s.name, s.viewmat, s.K, s.image, s.mask, s.depth):
                add(item)
            if s.lens:
                add(repr(s.lens))
    add(repr(bounds))
    if paper is not None:
        add(repr(paper))
    if any(given):
        add(repr(given))
    add(points.xyz)
    add(points.rgb)
    add(points.seen)
    return digest.hexdigest()


def assemble(
    name: str,
    protocol: str,
    train: Sequence[Shot],
    test: Sequence[Shot],
    points: Tracks,
    near: float,
    far: float,
    paper: float | None = None,
    given: tuple[bool, bool] = (False, False),
) -> Scene:
    """Make a scene of shots and points.

    Args:
        name: of the scene.
        protocol: name of the split.
        train, test: the shots; test shots without tags get that of their camera's position.
        points: `seen` is over the training shots, in their order.
        near, far: depth bounds.
        paper: grey value in [0, 1] behind transparent photos.
        given: whether the user gave near, and far.

    Raises:
        UserError: a shot or a bound is invalid.
    """
    from framework.types import Scene, TrainingSet

    where, both = f"scene {name}", [*train, *test]
    for shot in both:
        _check(shot)
    _warn_of_orientations(where, both)
    check_bounds(near, far, where)
    check_places(_centers(both), [shot.name for shot in both], far, where)
    focal = max(float(shot.K[:2, :2].max()) for shot in both)
    _warn_of_one_place(where, train, near)
    _warn_of_copies(where, train, test, near)
    check_rounding(_centers(both), focal, near, where)
    if not len(points.xyz):
        points = points.for_training(range(len(train)))
    paper = paper if any(shot.clear for shot in train) else None
    views, bounds = tuple(map(_view, train)), (float(near), float(far))
    training = TrainingSet(name, views, _points(points), near, far, paper, given)
    fingerprint = _fingerprint(protocol, train, test, points, bounds, paper, given)
    tags = placement(_centers(test), _centers(train))
    tagged = [s if s.tags else replace(s, tags=tag) for s, tag in zip(test, tags, strict=True)]
    return Scene(name, protocol, training, tuple(map(_view, tagged)), fingerprint)
