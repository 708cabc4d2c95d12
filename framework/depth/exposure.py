"""Equalises photos of one scene that were exposed differently.

A camera that chooses exposure and white balance again for every photo gives a surface another
colour in each. Gaussians can only explain that by several of them in one place. If stereo finds a
surface in photos i and j, the ratio of its colours is exp(g_i - g_j), with g the photos' log gains.
For every pair of neighbours, the shared pixels are divided into four quarters k by brightness. The
median difference e and the median mean l of the two colours in a quarter hardly depend on
highlights, shading and wrong depth. They give a log ratio r = log((l + e/2) / (l - e/2)). In each
colour channel the gains minimise

    sum_ijk l_ijk^2 (r_ijk - (g_i - g_j))^2 + prior sum_i g_i^2,

where the last term, `PRIOR` times the pairs' mean weight, puts the mean gain at 0 and determines
the gains of unconnected photos. The weight is l, because stray light and tone curves lift dark
colours. Distant views match few pixels, and wrongly, so a pair's ratios are multiplied by

    sum_k l_ijk^2 / (sum_k l_ijk^2 + (s / `USUAL`)^2),

where s is the spread of the pixels' differences about the median of their quarter (1.4826 times
their median absolute deviation). This is the posterior mean if every quarter measures the
difference with error s, and the prior for two photos' log exposures has deviation `USUAL`.

If the gains are below `LEAST`, photos count as equal and nothing is changed. The same holds for
fewer than `ENOUGH` photos, in which exposure and a surface that shines to one side look alike.

A new view is exposed like the photos around it: its log gain is the mean of those of the nearest
cameras, weighted by 1 / distance^2 (Shepard 1968). Test photos are not used.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from framework.compute.portable import exp, log
from framework.depth.transfer import pixel_transfer
from framework.geometry import distance
from framework.types import Camera, DepthMap, View

Floats = NDArray[np.float64]

ENOUGH = 6  # photos
NEAREST = 8  # photos that one is compared with, and that a new view is exposed like
COMPARED = 30_000  # pixels of a photo at most, evenly over it
TOLERANCE = 0.02  # relative difference of depths that are of one surface
DARK, BRIGHT = 0.02, 0.98  # colours between these are not clipped
FEWEST = 200  # pixels that make a pair
PARTS = 4  # by brightness
PRIOR = 1e-6
USUAL = math.log(2) / 3  # a third of a stop, by which cameras step
TO_DEVIATION = 1.4826  # from the median absolute deviation to the standard one, of a normal error
LEAST = 0.01  # root mean square of the log gains


@dataclass(frozen=True)
class Exposures:
    """log_gains: [n, 3] of every photo's colours, mean 0. cameras: of these photos."""

    cameras: tuple[Camera, ...]
    log_gains: Floats

    def evened(self, views: Sequence[View]) -> tuple[View, ...]:
        """The photos as if exposed alike."""
        return tuple(
            replace(view, image=view.image / _channels(gains))
            for view, gains in zip(views, self.log_gains, strict=True)
        )

    @property
    def size(self) -> float:
        """The root mean square of the log gains."""
        return _size(self.log_gains)

    def message(self) -> str:
        """A line for the screen."""
        return (
            f"the photos were exposed differently (root mean square {100 * self.size:.0f} %), which"
            " is evened; trainer.exposure=false leaves them as they are"
        )

    def factors(self, camera: Camera) -> list[float]:
        """[3] factors of a render of the evened scene for this camera."""
        return [float(factor) for factor in exp(self.at(camera))]

    def applied(self, rgb: Tensor, camera: Camera) -> Tensor:
        """A render [3, H, W] of the evened scene, exposed as the photos around `camera` were."""
        return rgb * _channels(self.at(camera))

    def at(self, camera: Camera) -> Floats:
        """[3] log gains of a new view, or of one of the photos."""
        for other, gains in zip(self.cameras, self.log_gains, strict=True):
            if other is camera:
                return gains
        away = np.array([distance(camera, other) for other in self.cameras])
        near = np.argsort(away, kind="stable")[:NEAREST]
        scale = max(float(away[near[-1]]), 1e-12)
        weights = 1 / ((away[near] / scale) ** 2 + 1e-6)  # finite where a photo was taken
        weights /= math.fsum(weights)
        return np.array([math.fsum(weights * gains) for gains in self.log_gains[near].T])


def find_exposures(views: Sequence[View], depth: Sequence[DepthMap]) -> Exposures | None:
    """Estimate exposures of training views from their depth; None if they are equal or unknown."""
    n = len(views)
    if n < ENOUGH:
        return None
    systems, right = np.zeros((3, n, n)), np.zeros((3, n))
    for i, j, levels, ratios, spreads in _compared(views, depth):
        for c in range(3):
            weight = math.fsum(levels[c] ** 2)
            trust = weight / (weight + (spreads[c] / USUAL) ** 2)
            pull = trust * math.fsum(levels[c] ** 2 * ratios[c])
            systems[c][[i, j], [i, j]] += weight
            systems[c][[i, j], [j, i]] -= weight
            right[c][[i, j]] += pull, -pull
    for system in systems:
        prior = PRIOR * math.fsum(np.diagonal(system)) / n
        system[range(n), range(n)] += prior if prior > 0 else 1.0
    gains = np.stack([_solved(*of) for of in zip(systems, right, strict=True)], axis=1)
    if _size(gains) < LEAST:
        return None
    return Exposures(tuple(view.camera for view in views), gains)


def _compared(
    views: Sequence[View], depth: Sequence[DepthMap]
) -> Iterator[tuple[int, int, Floats, Floats, Floats]]:
    """(i, j, [3, PARTS] mean colours, [3, PARTS] log ratios of photo i to j, [3] the spread of
    differences) of neighbours."""
    colours = [_smoothed(view) for view in views]
    depths = [_certain_depth(view, of) for view, of in zip(views, depth, strict=True)]
    for i, view in enumerate(views):
        away = [distance(view.camera, other.camera) for other in views]
        order = np.argsort(away, kind="stable")
        for j in [int(k) for k in order if k != i][:NEAREST]:
            pixels, others = _shared(depths[i], depths[j], view.camera, views[j].camera)
            ours = colours[i][:, pixels].astype(np.float64)
            theirs = colours[j][:, others].astype(np.float64)
            lowest = np.minimum(ours, theirs).min(0, initial=1)
            highest = np.maximum(ours, theirs).max(0, initial=0)
            clean = (lowest > DARK) & (highest < BRIGHT)
            if clean.sum() >= FEWEST:
                yield i, j, *_by_brightness(ours[:, clean], theirs[:, clean])


def _by_brightness(a: Floats, b: Floats) -> tuple[Floats, Floats, Floats]:
    """Medians of the means, and log ratios, of colours [3, M] in two photos, both [3, PARTS]; and
    [3] the spread of their differences."""
    order = np.argsort(a + b, axis=1, kind="stable")

    def parts(values: Floats) -> list[Floats]:
        return np.array_split(np.take_along_axis(values, order, axis=1), PARTS, axis=1)

    def medians(each: list[Floats]) -> Floats:
        return np.stack([np.median(part, axis=1) for part in each], axis=1)

    levels, apart = medians(parts(0.5 * (a + b))), parts(a - b)
    differences = medians(apart)
    about = [abs(part - middle[:, None]) for part, middle in zip(apart, differences.T, strict=True)]
    halves = np.clip(0.5 * differences / levels, -0.9, 0.9)
    spreads = TO_DEVIATION * np.median(medians(about), axis=1)
    return levels, log((1 + halves) / (1 - halves)), spreads


def _certain_depth(view: View, depth: DepthMap) -> NDArray[np.float32]:
    """[H, W] depth of the photo's surfaces, 0 = unknown or a guess."""
    valid = depth.confidence.numpy() > 0
    if view.mask is not None:
        valid &= view.mask.numpy() > 0.5
    return np.where(valid, depth.depth.numpy(), np.float32(0))


def _shared(
    depth: NDArray[np.float32], other: NDArray[np.float32], a: Camera, b: Camera
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Pixels of `a`, row by row, and the pixels of `b` with the same surface. depth, other: [H, W]
    of the two views, 0 = unknown."""
    stride = max(1, math.ceil(math.sqrt(a.height * a.width / COMPARED)))
    rows, columns = np.mgrid[0 : a.height : stride, 0 : a.width : stride].reshape(2, -1)
    z = depth[rows, columns].astype(np.float64)
    rows, columns, z = rows[z > 0], columns[z > 0], z[z > 0]
    A, t = pixel_transfer(a, b)
    x, y = columns + 0.5, rows + 0.5
    u, v, w = (z * (A[k, 0] * x + A[k, 1] * y + A[k, 2]) + t[k] for k in range(3))
    front = w > 0
    safe = np.where(front, w, 1.0)
    u, v = u / safe, v / safe
    inside = front & (u >= 0) & (v >= 0) & (u < b.width) & (v < b.height)
    pixels = (rows * a.width + columns)[inside]
    there = v[inside].astype(np.int64) * b.width + u[inside].astype(np.int64)
    seen = other.reshape(-1)[there].astype(np.float64)
    same = np.abs(w[inside] - seen) < TOLERANCE * seen
    return pixels[same], there[same]


def _smoothed(view: View) -> NDArray[np.float32]:
    """[3, H W] means over the valid pixels of 5 x 5, summed in a fixed order."""
    image = view.image.numpy()
    shown = np.ones_like(image[:1])
    if view.mask is not None:
        shown[0] = view.mask.numpy() > 0.5
    height, width = image.shape[1:]
    total = np.pad(np.concatenate([image * shown, shown]), ((0, 0), (2, 2), (2, 2)))
    down = sum((total[:, k : k + height] for k in range(1, 5)), total[:, :height])
    across = sum((down[:, :, k : k + width] for k in range(1, 5)), down[:, :, :width])
    return np.asarray(across[:3] / np.maximum(across[3], 1)).reshape(3, -1)


def _solved(system: Floats, right: Floats) -> Floats:
    """Solve system x = right, [n, n] and [n], by elimination in a fixed order. The diagonal
    outweighs its row, so no pivot is small."""
    system, x = system.copy(), right.copy()
    for k in range(len(x)):
        factors = system[k + 1 :, k] / system[k, k]
        system[k + 1 :] -= factors[:, None] * system[k]
        x[k + 1 :] -= factors * x[k]
    for k in reversed(range(len(x))):
        x[k] = (x[k] - math.fsum(system[k, k + 1 :] * x[k + 1 :])) / system[k, k]
    return x


def _size(log_gains: Floats) -> float:
    """The root mean square of [n, 3]."""
    return math.sqrt(math.fsum(log_gains.ravel() ** 2) / log_gains.size)


def _channels(log_gains: Floats) -> Tensor:
    """[3, 1, 1] float32 factors of log gains [3]."""
    import torch

    return torch.from_numpy(exp(log_gains)).float()[:, None, None]
