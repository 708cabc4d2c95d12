"""Depth made worse on purpose, for stress studies: what does a method do when its depth is wrong?

Every corruption keeps the pixels without depth as they are and, except `holes`, the confidence: a
provider that errs does not know it. Lengths are shares of the image's diagonal, so that the size of
the photos plays no part. At strength s in [0, 1]:

- `noise`: z exp(0.1 s g), g a standard normal field that is correlated over 1 % of the diagonal:
  at s = 1 a depth is off by 10 %, about what a monocular network is after alignment.
- `bias`: z exp(0.2 s b), b a constant of the view: the values of all views are spread evenly over
  [-1, 1] in random order (1 for a single view), so that at s = 1 the views' scales differ by up to
  e^0.4 = 1.5.
- `holes`: the depth of the share 0.9 s of the known pixels is unknown (confidence 0), in blobs of
  about 4 % of the diagonal. A weaker hole lies within a stronger one.
- `blur`: inverse depth is smoothed by a Gaussian of standard deviation 0.02 s diagonals: surfaces
  grow tails across depth edges, as in the output of a network at low resolution.

The draws of one seed are the same at every strength: a sweep over strengths scales one error.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np
import torch
from scipy.ndimage import correlate1d

from framework.compute import portable
from framework.compute.rng import stream
from framework.types import DepthMap

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

NOISE, NOISE_LENGTH = 0.1, 0.01
BIAS = 0.2
HOLES, HOLES_LENGTH = 0.9, 0.04
BLUR_LENGTH = 0.02


def corrupt(
    maps: Sequence[DepthMap], kinds: Sequence[str], strength: float, seed: int
) -> tuple[DepthMap, ...]:
    """New maps: each of `kinds` applied in turn to all `maps`, see the module."""
    spoiled = [(m.depth.numpy().astype(np.float64), m.confidence.numpy()) for m in maps]
    for kind in kinds:
        change = _KINDS[kind]
        spoiled = [
            change(depth, confidence, view, len(maps), strength, seed)
            for view, (depth, confidence) in enumerate(spoiled)
        ]
    return tuple(
        DepthMap(torch.from_numpy(d.astype(np.float32)), torch.from_numpy(c.copy()))
        for d, c in spoiled
    )


def _noise(
    depth: Array, confidence: NDArray[np.float32], view: int, n: int, strength: float, seed: int
) -> tuple[Array, NDArray[np.float32]]:
    field = normal_field(depth.shape, NOISE_LENGTH, stream(seed, "depth/noise", view))
    return depth * portable.exp(NOISE * strength * field), confidence


def _bias(
    depth: Array, confidence: NDArray[np.float32], view: int, n: int, strength: float, seed: int
) -> tuple[Array, NDArray[np.float32]]:
    spread = np.linspace(-1.0, 1.0, n) if n > 1 else np.ones(1)
    share = stream(seed, "depth/bias").permutation(spread)[view]
    return depth * portable.exp(BIAS * strength * share), confidence


def _holes(
    depth: Array, confidence: NDArray[np.float32], view: int, n: int, strength: float, seed: int
) -> tuple[Array, NDArray[np.float32]]:
    known = depth > 0
    field = normal_field(depth.shape, HOLES_LENGTH, stream(seed, "depth/holes", view))
    count = round(HOLES * strength * int(known.sum()))
    lowest = np.argsort(np.where(known, field, np.inf), axis=None, kind="stable")[:count]
    kept = known.copy()
    kept.ravel()[lowest] = False
    return np.where(kept, depth, 0.0), np.where(kept, confidence, np.float32(0))


def _blur(
    depth: Array, confidence: NDArray[np.float32], view: int, n: int, strength: float, seed: int
) -> tuple[Array, NDArray[np.float32]]:
    """Normalised convolution (Knutsson & Westin, CVPR 1993): unknown pixels weigh nothing."""
    known = depth > 0
    inverse = np.where(known, 1.0 / np.where(known, depth, 1.0), 0.0)
    sigma_px = BLUR_LENGTH * strength * math.hypot(*depth.shape)
    total = _smoothed(inverse, sigma_px, "nearest")
    weight = _smoothed(known.astype(np.float64), sigma_px, "nearest")
    return np.where(known, weight / np.where(known, total, 1.0), depth), confidence


_KINDS: dict[str, Callable[..., tuple[Array, NDArray[np.float32]]]] = {
    "noise": _noise,
    "bias": _bias,
    "holes": _holes,
    "blur": _blur,
}


def normal_field(shape: tuple[int, ...], length: float, rng: np.random.Generator) -> Array:
    """[H, W] standard normal values, correlated over the share `length` of the diagonal: white
    noise smoothed by a Gaussian of that standard deviation, of periodic border so that the variance
    is the same everywhere, and divided by its exact deviation."""
    sigma_px = length * math.hypot(*shape)
    impulse = np.zeros(shape)
    impulse[0, 0] = 1.0
    response = _smoothed(impulse, sigma_px, "wrap")
    smooth = _smoothed(rng.standard_normal(shape), sigma_px, "wrap")
    return smooth / math.sqrt(float(np.square(response).sum()))


def _smoothed(values: Array, sigma_px: float, mode: str) -> Array:
    """`values` [H, W] through a Gaussian cut at four standard deviations."""
    reach = int(4 * sigma_px + 0.5)
    taps = portable.exp(-0.5 * np.square(np.arange(-reach, reach + 1) / sigma_px))
    taps /= taps.sum()
    for axis in (0, 1):
        values = correlate1d(values, taps, axis, mode=mode)
    return values
