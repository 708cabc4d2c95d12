"""A synthetic forward-facing scene with the load of a trained LLFF scene at 1/8 resolution.

Six depth layers; the nearer ones cover patches of the image, the farther ones more and more of it.
Footprints are log-normal around 2 px with a tail of large ones, opacities mostly high, colours
from SH of degree 3 with falling amplitudes. The camera is the world's origin, 504x378, f = 400 px.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from framework.compute.rng import stream
from framework.types import Camera, Gaussians

WIDTH, HEIGHT, FOCAL_PX = 504, 378, 400.0
LAYER_DEPTHS = np.array([2.5, 4.0, 6.0, 9.0, 13.0, 19.0])
LAYER_SHARES = np.array([0.12, 0.15, 0.18, 0.2, 0.2, 0.15])
LAYER_THRESHOLDS = np.array([0.45, 0.3, 0.15, 0.0, -0.3, -np.inf])  # of the coverage pattern
LARGE_SHARE, LARGE_PX = 0.05, (6.0, 20.0)
SH_AMPLITUDES = np.repeat([0.6, 0.1, 0.05, 0.03], [1, 3, 5, 7])


def layered_scene(n: int, seed: int = 0, factor: float = 1.0) -> tuple[Gaussians, Camera]:
    """`n` Gaussians of SH degree 3 and the camera that sees them, with `factor` times the pixels in
    either direction."""
    rng = stream(seed, "benchmark-scene")
    layer = rng.choice(len(LAYER_DEPTHS), size=n, p=LAYER_SHARES)
    uv = _covered_pixels(rng, layer)
    z = LAYER_DEPTHS[layer] * (1 + 0.04 * rng.standard_normal(n))
    x, y = ((uv - [WIDTH / 2, HEIGHT / 2]) / FOCAL_PX * z[:, None]).T
    sigma_px = np.exp(np.log(2.0) + 0.5 * rng.standard_normal(n))
    large = rng.random(n) < LARGE_SHARE
    sigma_px[large] = rng.uniform(*LARGE_PX, int(large.sum()))
    log_scales = np.log(sigma_px * z / FOCAL_PX)[:, None] + 0.4 * rng.standard_normal((n, 3))
    low, high = np.log(0.05 / 0.95), np.log(0.99 / 0.01)
    sh = rng.standard_normal((n, 16, 3)) * SH_AMPLITUDES[:, None]
    gaussians = Gaussians(
        means=_tensor(np.stack([x, y, z], 1)),
        quats=_tensor(rng.standard_normal((n, 4))),
        log_scales=_tensor(log_scales),
        opacity_logits=_tensor(np.clip(rng.logistic(0.0, 1.0, n), low, high)),
        sh0=_tensor(sh[:, :1]),
        shN=_tensor(sh[:, 1:]),
    )
    return gaussians, _camera(factor)


def _camera(factor: float) -> Camera:
    width, height, focal = round(WIDTH * factor), round(HEIGHT * factor), FOCAL_PX * factor
    K = torch.tensor([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    return Camera(torch.eye(4), K, width, height)


def _covered_pixels(rng: np.random.Generator, layer: np.ndarray) -> np.ndarray:
    """[N, 2] pixels, uniform over the part of the image (and 20 px around) each layer covers."""
    uv = np.empty((len(layer), 2))
    todo = np.arange(len(layer))
    while len(todo):
        tried = rng.uniform([-20, -20], [WIDTH + 20, HEIGHT + 20], (len(todo), 2))
        inside = _pattern(tried, layer[todo]) > LAYER_THRESHOLDS[layer[todo]]
        uv[todo[inside]] = tried[inside]
        todo = todo[~inside]
    return uv


def _pattern(uv: np.ndarray, layer: np.ndarray) -> np.ndarray:
    """A smooth function of the pixel, another one for every layer, about in [-1.35, 1.35]."""
    u, v = uv.T
    broad = np.sin(u / 60 + layer * 2.1) * np.cos(v / 50 - layer * 1.3)
    return broad + 0.35 * np.sin(u / 17 + v / 23 + layer)


def _tensor(array: np.ndarray) -> Tensor:
    return torch.from_numpy(np.ascontiguousarray(array, dtype=np.float32))
