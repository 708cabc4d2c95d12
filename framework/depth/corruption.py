"""Corrupts depth on purpose, for stress studies.

Every corruption keeps the pixels without depth and, except `holes`, the confidence: a provider does
not notice its errors. Lengths are shares of the image's diagonal, so the size of the photos does
not matter. At strength s in [0, 1]:

- `noise`: z exp(0.1 s g), with g a standard normal field that is correlated over 1 % of the
  diagonal. At s = 1 a depth is off by 10 %, about like a monocular network after alignment.
- `bias`: z exp(0.2 s b), with b a constant of the view. The values of all views are spread evenly
  over [-1, 1] in random order (1 for a single view). At s = 1 scales differ by up to e^0.4 = 1.5.
- `holes`: the depth of a share 0.9 s of the known pixels is unknown (confidence 0), in blobs of
  about 4 % of the diagonal. A weaker hole lies within a stronger one.
- `blur`: inverse depth is smoothed by a Gaussian of standard deviation 0.02 s diagonals. Surfaces
  grow tails across depth edges, as in the output of a network at low resolution.

The draws of a seed are the same at every strength: a sweep over strengths scales one error.
"""

import math
from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import correlate1d

from framework.compute import portable
from framework.compute.rng import stream
from framework.types import DepthMap

Array = NDArray[np.float64]

NOISE, NOISE_LENGTH = 0.1, 0.01
BIAS = 0.2
HOLES, HOLES_LENGTH = 0.9, 0.04
BLUR_LENGTH = 0.02


def corrupt(
    maps: Sequence[DepthMap], kinds: Sequence[str], strength: float, seed: int
) -> tuple[DepthMap, ...]:
    """Apply each of `kinds` in turn to all `maps`; see the module's docstring."""
    corrupted = []
    for view, one in enumerate(maps):
        depth, confidence = one.depth.numpy().astype(np.float64), one.confidence.numpy().copy()
        for kind in kinds:
            if kind == "noise":
                depth = _noise(depth, strength, stream(seed, "depth/noise", view))
            elif kind == "bias":
                depth = _bias(depth, view, len(maps), strength, seed)
            elif kind == "holes":
                kept = _kept(depth, strength, stream(seed, "depth/holes", view))
                depth, confidence = depth * kept, confidence * kept
            else:
                depth = _blur(depth, strength)
        corrupted.append(
            DepthMap(torch.from_numpy(depth.astype(np.float32)), torch.from_numpy(confidence))
        )
    return tuple(corrupted)


def _noise(depth: Array, strength: float, rng: np.random.Generator) -> Array:
    field = normal_field(depth.shape, NOISE_LENGTH, rng)
    return depth * portable.exp(NOISE * strength * field)


def _bias(depth: Array, view: int, n: int, strength: float, seed: int) -> Array:
    spread = np.linspace(-1.0, 1.0, n) if n > 1 else np.ones(1)
    share = stream(seed, "depth/bias").permutation(spread)[view]
    return depth * portable.exp(BIAS * strength * share)


def _kept(depth: Array, strength: float, rng: np.random.Generator) -> NDArray[np.bool_]:
    """The known pixels outside of the holes."""
    valid = depth > 0
    field = normal_field(depth.shape, HOLES_LENGTH, rng)
    count = round(HOLES * strength * int(valid.sum()))
    lowest = np.argsort(np.where(valid, field, np.inf), axis=None, kind="stable")[:count]
    kept = valid.copy()
    kept.ravel()[lowest] = False
    return kept


def _blur(depth: Array, strength: float) -> Array:
    """Normalised convolution (Knutsson & Westin, CVPR 1993): unknown pixels have weight 0."""
    valid = depth > 0
    inverse = np.where(valid, 1.0 / np.where(valid, depth, 1.0), 0.0)
    sigma_px = BLUR_LENGTH * strength * math.hypot(*depth.shape)
    total = _smoothed(inverse, sigma_px, "nearest")
    weight = _smoothed(valid.astype(np.float64), sigma_px, "nearest")
    return np.where(valid, weight / np.where(valid, total, 1.0), depth)


def normal_field(shape: tuple[int, ...], length: float, rng: np.random.Generator) -> Array:
    """[H, W] standard normal values, correlated over the share `length` of the diagonal.

    White noise is smoothed by a Gaussian of that standard deviation, with a periodic border so that
    the variance is the same everywhere, and divided by its exact deviation.
    """
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
