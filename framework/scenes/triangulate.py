"""Triangulates sparse points of photos with known poses from SIFT matches.

Only the training photos are used, so the points are independent of the test photos.
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from framework.compute.elementary import inverse, product
from framework.errors import require
from framework.scenes.assemble import Shot, Tracks
from framework.scenes.cameras import center_of

log = logging.getLogger(__name__)

SIDE = 1200  # pixels; larger photos are reduced to it before features are found
FEATURES = 2000  # per photo
PARTNERS = 8  # photos that each one is matched with: those with the nearest cameras
RATIO = 0.8  # of the distances of the best and the second best match (Lowe 2004)
REPROJECTION = 2.0  # pixels of a photo of at most SIDE
COSINE = 0.999657  # of the least angle between the two rays: 1.5 degrees, as COLMAP
FEWEST = 10  # points, else they are not trusted


@dataclass(frozen=True)
class _Features:
    """SIFT features of a photo.

    pixels: [F, 2] places in the photo; scale: of it, to at most `SIDE`. center: [3] of the camera.
    rays: [F, 3] unit directions in the world. rgb: [F, 3] colours.
    """

    shot: Shot
    scale: float
    center: NDArray[np.float64]
    pixels: NDArray[np.float64]
    rays: NDArray[np.float64]
    rgb: NDArray[np.uint8]
    descriptors: NDArray[np.uint8]


def triangulate(shots: Sequence[Shot], where: str) -> Tracks:
    """Triangulate SIFT matches between photos.

    Args:
        shots: pinhole photos with their poses; masked pixels have no features.
        where: starts a message.

    Returns:
        A point per match, seen by its two photos.

    Raises:
        UserError: fewer than `FEWEST` matches fit the poses.
    """
    features = [_features(shot) for shot in shots]
    points, colours, pairs = [np.zeros((0, 3))], [np.zeros((0, 3), np.uint8)], []
    for i, j in _pairs([f.center for f in features]):
        xyz, rgb = _match(features[i], features[j])
        points.append(xyz)
        colours.append(rgb)
        pairs += [(i, j)] * len(xyz)
    require(
        len(pairs) >= FEWEST,
        f"{where}: no sparse points to find depth bounds in, and only {len(pairs)} matches of the"
        " training photos fit the poses; check the poses, or give scene.near and scene.far",
    )
    log.warning(
        f"{where}: no sparse points, so {len(pairs)} points and the depth bounds were triangulated"
        " from matches of the training photos; scene.near and scene.far set other bounds"
    )
    seen = np.zeros((len(pairs), len(shots)), dtype=bool)
    seen[np.arange(len(pairs))[:, None], pairs] = True
    return Tracks(np.concatenate(points), np.concatenate(colours), seen)


def _features(shot: Shot) -> _Features:
    import cv2

    height, width = shot.image.shape[:2]
    scale = min(1.0, SIDE / max(height, width))
    grey = cv2.cvtColor(shot.image, cv2.COLOR_RGB2GRAY)
    mask = None if shot.mask is None else (255 * shot.mask).astype(np.uint8)
    if scale < 1:
        size = (round(width * scale), round(height * scale))
        grey = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
        if mask is not None:
            mask = np.asarray(cv2.resize(mask, size, interpolation=cv2.INTER_NEAREST), np.uint8)
    sift: Any = getattr(cv2, "SIFT_create")(FEATURES)  # noqa: B009 - not in OpenCV's stubs
    keypoints, descriptors = sift.detectAndCompute(grey, mask)
    if descriptors is None:
        keypoints, descriptors = (), np.zeros((0, 128), np.uint8)
    places = np.array([k.pt for k in keypoints], np.float64).reshape(-1, 2)
    pixels = (places + 0.5) * [width / grey.shape[1], height / grey.shape[0]]
    rays = np.column_stack([pixels, np.ones(len(pixels))])
    turn = product(inverse(shot.K).T, shot.viewmat[:3, :3])
    rays = product(rays, turn)
    column, row = np.clip(pixels.astype(int), 0, [width - 1, height - 1]).T
    return _Features(
        shot,
        scale,
        center_of(shot.viewmat),
        pixels,
        rays / np.sqrt(np.square(rays).sum(axis=1, keepdims=True)),
        shot.image[row, column],
        np.asarray(descriptors, np.uint8),
    )


def _pairs(centers: Sequence[NDArray[np.float64]]) -> list[tuple[int, int]]:
    """Pairs of each photo and its nearest ones."""
    apart = np.linalg.norm(np.array(centers)[:, None] - np.array(centers), axis=2)
    np.fill_diagonal(apart, np.inf)
    nearest = np.argsort(apart, axis=1, kind="stable")[:, : min(PARTNERS, len(centers) - 1)]
    return sorted({(min(i, j), max(i, j)) for i, row in enumerate(nearest.tolist()) for j in row})


def _match(a: _Features, b: _Features) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """Points [M, 3] and colours [M, 3] of the matches that fit the poses.

    A point is the middle of the shortest segment between its two rays.
    """
    index = _mutual(a.descriptors, b.descriptors)
    p, q, between = a.rays[index[:, 0]], b.rays[index[:, 1]], b.center - a.center
    cosine = (p * q).sum(axis=1)
    along_p, along_q = (p * between).sum(axis=1), (q * between).sum(axis=1)
    sine2 = np.maximum(1 - cosine * cosine, 1e-12)
    s, t = (along_p - cosine * along_q) / sine2, (cosine * along_p - along_q) / sine2
    xyz = (a.center + s[:, None] * p + b.center + t[:, None] * q) / 2
    good = (s > 0) & (t > 0) & (cosine < COSINE)
    good &= (_error(a, xyz, index[:, 0]) < REPROJECTION) & (
        _error(b, xyz, index[:, 1]) < REPROJECTION
    )
    return xyz[good], a.rgb[index[good, 0]]


def _mutual(a: NDArray[np.uint8], b: NDArray[np.uint8]) -> NDArray[np.intp]:
    """[M, 2] pairs of features that are each other's best match, by a clear margin."""
    import cv2

    if min(len(a), len(b)) < 2:
        return np.zeros((0, 2), np.intp)
    ways = []
    for first, second in ((a, b), (b, a)):
        matches = cv2.BFMatcher(cv2.NORM_L2).knnMatch(first, second, k=2)
        clear = [best for best, other in matches if best.distance < RATIO * other.distance]
        ways.append({(m.queryIdx, m.trainIdx) for m in clear})
    pairs = sorted(ways[0] & {(i, j) for j, i in ways[1]})
    return np.array(pairs, np.intp).reshape(-1, 2)


def _error(f: _Features, xyz: NDArray[np.float64], index: NDArray[np.intp]) -> NDArray[np.float64]:
    """[M] reprojection error in pixels of the reduced photo; infinite behind the camera."""
    seen = product(xyz, f.shot.viewmat[:3, :3].T) + f.shot.viewmat[:3, 3]
    pixel = product(seen, f.shot.K.T)
    with np.errstate(divide="ignore", invalid="ignore"):
        off = pixel[:, :2] / pixel[:, 2:] - f.pixels[index]
    return np.where(pixel[:, 2] > 0, f.scale * np.sqrt(np.square(off).sum(axis=1)), np.inf)
