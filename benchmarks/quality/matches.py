"""Sparse points from the training photos alone, for comparison with a model of all photos."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import cv2
import numpy as np
import torch

from framework.types import SparsePoints, TrainingSet, View

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]
    Features = tuple[Array, NDArray[np.float32]]

RATIO = 0.8  # of the best to the second best distance of descriptors (Lowe 2004)
OFF = 1.5  # pixels from the epipolar line, and between a point and its keypoints
APART = 3.0  # pixels from the best match, from which another one is the second
LEAST_ANGLE = 0.5  # degrees between the rays of a point
NONE = 9.0  # farther than any two descriptors


def matched_points(training: TrainingSet) -> SparsePoints:
    """SIFT in every photo, matched between all pairs along epipolar lines, both ways, and
    triangulated; grey."""
    found = [_features(view) for view in training.views]
    places, seen = [], []
    for pair in itertools.combinations(range(len(training.views)), 2):
        first, second = (training.views[i] for i in pair)
        points = _triangulated(first, second, found[pair[0]], found[pair[1]])
        known = np.zeros((len(points), len(training.views)), bool)
        known[:, pair] = True
        places.append(points)
        seen.append(known)
    xyz = torch.from_numpy(np.concatenate(places))
    grey = torch.full(xyz.shape, 0.5, dtype=torch.float32)
    return SparsePoints(xyz, grey, torch.from_numpy(np.concatenate(seen)))


def _features(view: View) -> Features:
    """[P, 2] pixels and [P, 128] descriptors of length 1, the square roots of SIFT's."""
    photo = (view.image.numpy().transpose(1, 2, 0) * 255).round().astype(np.uint8)
    grey = cv2.cvtColor(photo, cv2.COLOR_RGB2GRAY)
    keys, descriptors = cv2.SIFT.create(contrastThreshold=0.02).detectAndCompute(grey, None)  # type: ignore[call-overload]
    uv = np.array([key.pt for key in keys]) + 0.5
    shares = descriptors / np.maximum(descriptors.sum(1, keepdims=True), 1e-9)
    return uv, np.sqrt(shares).astype(np.float32)


def _triangulated(first: View, second: View, a: Features, b: Features) -> Array:
    """[P, 3] points of a pair, in front of both cameras, that lie on their keypoints."""
    matrices = [view.camera.viewmat.double().numpy() for view in (first, second)]
    K = [view.camera.K.double().numpy() for view in (first, second)]
    move = matrices[1] @ np.linalg.inv(matrices[0])
    x, y, z = move[:3, 3]
    across = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    F = np.linalg.inv(K[1]).T @ across @ move[:3, :3] @ np.linalg.inv(K[0])
    lines = np.column_stack([a[0], np.ones(len(a[0]))]) @ F.T
    lines /= np.linalg.norm(lines[:, :2], axis=1, keepdims=True)
    off = np.abs(lines @ np.column_stack([b[0], np.ones(len(b[0]))]).T)
    distance = np.where(off < OFF, np.sqrt(np.maximum(2 - 2 * a[1] @ b[1].T, 0)), NONE)
    match = distance.argmin(1)
    others = np.linalg.norm(b[0][match][:, None] - b[0][None], axis=2) >= APART
    second_best = np.minimum(np.where(others, distance, NONE).min(1), 1.0)
    rows = np.arange(len(match))
    kept = (distance[rows, match] < RATIO * second_best) & (distance.argmin(0)[match] == rows)
    uv = a[0][kept], b[0][match[kept]]
    projections = [k @ m[:3] for k, m in zip(K, matrices, strict=True)]
    four = cv2.triangulatePoints(*projections, *(values.T for values in uv))
    points: Array = (four[:3] / four[3]).T
    good = np.ones(len(points), bool)
    for projection, values in zip(projections, uv, strict=True):
        seen = np.column_stack([points, np.ones(len(points))]) @ projection.T
        good &= (seen[:, 2] > 0) & (
            np.linalg.norm(seen[:, :2] / seen[:, 2:] - values, axis=1) < OFF
        )
    rays = [points - np.linalg.inv(m)[:3, 3] for m in matrices]
    cosine = (rays[0] * rays[1]).sum(1) / np.prod([np.linalg.norm(r, axis=1) for r in rays], axis=0)
    return points[good & (cosine < np.cos(np.radians(LEAST_ANGLE)))]
