"""Forward warping of training views into a new camera by a soft z-buffer.

Depth is camera-space z in scene units; the centre of pixel (0, 0) is at (0.5, 0.5); images are
planar [3, H, W]. A source pixel (col, row) with depth z lands in the target at

    (x, y, w) = K_t R K_s^-1 (col, row, 1) + K_t t / z,   target depth z' = w z,

with (R, t) the pose of the source relative to the target. Written with 1/z, everything but the
depth is dimensionless: scaling a scene changes nothing. The first pass finds the nearest depth
z_min of every target pixel. The second one blends with weights
bilinear x exp(-(z' - z_min) / (temperature z_min)), the z_min-relative form of a soft z-buffer
(compare Niklaus & Liu, "Softmax splatting", CVPR 2020).

Pixels at a depth discontinuity mix two surfaces: they hide what is behind them, but paint nothing.
Results are bit-identical on any number of threads.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from framework.compute.parallel import BLOCKS, run_blocks
from framework.compute.portable import inverse, product
from framework.types import Camera, DepthMap, View
from framework.warp import kernels as warp_kernels

EDGE = 0.03  # a depth edge: second difference of 1/z, zero on any plane, above this share of 1/z
REFINE_ABOVE = 1.4  # magnification from which bilinear footprints of single pixels leave gaps


@dataclass(frozen=True)
class Support:
    """A training view prepared for warping.

    Attributes:
        inverse_depth: [H, W] float32, 0 = unknown.
        paints: [H, W] bool, False where unknown or at a depth edge.
        color: [H, W, 3] float32, contiguous.
    """

    camera: Camera
    inverse_depth: Tensor
    paints: Tensor
    color: Tensor

    @cached_property
    def brightest(self) -> float:
        """The largest value of a colour: above 1 in photos whose exposures were evened."""
        return float(self.color.max())

    @cached_property
    def known(self) -> float:
        """The share of the frame whose depth is known."""
        return int((self.inverse_depth > 0).sum()) / self.inverse_depth.numel()

    @cached_property
    def refined(self) -> Support:
        """The same view at twice the resolution: colours and, on smooth surface, 1/z bilinear."""
        color, inverse = self.color.permute(2, 0, 1)[None], self.inverse_depth[None, None]
        smooth = _bilinear(self.paints[None, None].float()) == 1.0
        nearest = inverse.repeat_interleave(2, 2).repeat_interleave(2, 3)
        K = self.camera.K.clone()
        K[:2] *= 2
        camera = Camera(self.camera.viewmat, K, 2 * self.camera.width, 2 * self.camera.height)
        return Support(
            camera,
            torch.where(smooth, _bilinear(inverse), nearest)[0, 0],
            self.paints.repeat_interleave(2, 0).repeat_interleave(2, 1),
            _bilinear(color)[0].permute(1, 2, 0).contiguous(),
        )


@dataclass(frozen=True)
class Warped:
    """The supports seen from a camera.

    Attributes:
        image: [3, H, W] float32, 0 outside the mask.
        mask: [H, W] float32, 0 or 1.
        depth: [H, W] float32 in scene units, 0 outside the mask.
        weight: [H, W], accumulated; about 1 per support that sees the pixel's surface.
    """

    image: Tensor
    mask: Tensor
    depth: Tensor
    weight: Tensor

    @property
    def coverage(self) -> float:
        """The share of the frame inside the mask."""
        return float(np.mean(self.mask.numpy(), dtype=np.float64))


def prepare(views: Sequence[View], depth_maps: Sequence[DepthMap]) -> tuple[Support, ...]:
    """Make views ready for warping. Only pixels with depth > 0, confidence > 0 and inside the
    view's mask enter."""
    return tuple(_prepare(view, depth) for view, depth in zip(views, depth_maps, strict=True))


def warp(
    supports: Sequence[Support],
    target: Camera,
    *,
    temperature: float = 0.02,
    min_weight: float = 0.5,
    erode: bool = True,
) -> Warped:
    """Warp all `supports` into `target`, blended in one soft z-buffer.

    Args:
        temperature: depth softness as a share of the nearest depth.
        min_weight: accumulated weight below which a pixel counts as a hole.
        erode: drop the outermost pixel of ragged borders (lone holes and the frame have none).
    """
    shape = (target.height, target.width)
    cells = (-(-target.height // BLOCKS) + 2) * (target.width + 2)
    z_min = np.full((BLOCKS, cells), np.inf, np.float32)
    sums = np.zeros((BLOCKS, 5 * cells), np.float32)
    points = [_project(support, target) for support in supports]
    for p in points:
        run_blocks(warp_kernels.nearest, *shape, p.u, p.v, p.depth, p.bounds, z_min)
    for p in points:
        run_blocks(
            warp_kernels.splat,
            *(*shape, p.u, p.v, p.depth, p.bounds, p.color, p.inverse_depth),
            *(p.zoom, p.subdivision, float(temperature), z_min, sums),
        )
    brightest = max([1.0, *(support.brightest for support in supports)])
    return _resolve(sums, shape, float(min_weight), brightest, erode)


def relative_projection(source: Camera, target: Camera) -> np.ndarray:
    """[3, 4] float64 P with (x, y, w) = P (col, row, 1, 1/z), w = target z / source z."""
    relative = product(target.viewmat.numpy(), inverse(source.viewmat.numpy()))
    K_target, K_source = target.K.numpy(), source.K.numpy()
    homography = product(product(K_target, relative[:3, :3]), inverse(K_source))
    shift = product(K_target, relative[:3, 3])
    return np.ascontiguousarray(np.column_stack([homography, shift]))


@dataclass(frozen=True)
class _Points:
    """A projected support; see `warp_kernels.project` and `.splat`."""

    u: np.ndarray
    v: np.ndarray
    depth: np.ndarray
    bounds: np.ndarray
    color: np.ndarray
    inverse_depth: np.ndarray
    zoom: float
    subdivision: float


def _prepare(view: View, depth_map: DepthMap) -> Support:
    depth = depth_map.depth
    valid = torch.isfinite(depth) & (depth > 0) & (depth_map.confidence > 0)
    if view.mask is not None:
        valid &= view.mask > 0
    inverse = torch.where(valid, 1.0 / depth, 0.0).to(torch.float32).contiguous()
    color = view.image.to(torch.float32).permute(1, 2, 0).contiguous()
    return Support(view.camera, inverse, (valid & ~_depth_edge(inverse)).contiguous(), color)


def _depth_edge(inverse: Tensor) -> Tensor:
    """[H, W] bool: |a - 2b + c| > EDGE b for b's known neighbours a, c on a row or column.

    On a plane 1/z is linear in the pixel coordinates, so slant alone never makes an edge.
    """
    edge = torch.zeros_like(inverse, dtype=torch.bool)
    for dim in (0, 1):
        n = inverse.shape[dim]
        if n < 3:
            continue
        before, middle, after = (inverse.narrow(dim, i, n - 2) for i in range(3))
        jump = (before - 2 * middle + after).abs() > EDGE * middle
        edge.narrow(dim, 1, n - 2).logical_or_(jump & (before > 0) & (after > 0))
    return edge


def _project(support: Support, target: Camera) -> _Points:
    fine = _magnification(support, target) > REFINE_ABOVE
    used = support.refined if fine else support
    inverse = used.inverse_depth.numpy()
    u, v, depth = (np.empty(inverse.shape, np.float32) for _ in range(3))
    bounds = np.empty((inverse.shape[0], 2), np.float32)
    matrix = relative_projection(used.camera, target)
    run_blocks(warp_kernels.project, inverse, used.paints.numpy(), matrix, u, v, depth, bounds)
    zoom = float(target.K[0, 0] / support.camera.K[0, 0])
    subdivision = 2.0 if fine else 1.0
    return _Points(u, v, depth, bounds, used.color.numpy(), inverse, zoom, subdivision)


def _magnification(support: Support, target: Camera) -> float:
    """The 90th percentile of (f_t / z_t) / (f_s / z_s) over a sparse grid of the known pixels."""
    sparse = slice(4, None, 8)
    inverse = support.inverse_depth.numpy()[sparse, sparse].astype(np.float64)
    y = np.arange(support.camera.height)[sparse, None] + 0.5
    x = np.arange(support.camera.width)[None, sparse] + 0.5
    row = relative_projection(support.camera, target)[2]
    ratio = row[0] * x + row[1] * y + row[2] + row[3] * inverse
    ratio = ratio[(inverse > 0) & (ratio > warp_kernels.MIN_RATIO)]
    if ratio.size == 0:
        return 1.0
    return float(target.K[0, 0] / support.camera.K[0, 0] / np.percentile(ratio, 10))


def _resolve(
    sums: np.ndarray, shape: tuple[int, int], min_weight: float, brightest: float, erode: bool
) -> Warped:
    image = np.empty((3, *shape), np.float32)
    depth, weight = np.empty(shape, np.float32), np.empty(shape, np.float32)
    valid = np.empty(shape, np.bool_)
    run_blocks(warp_kernels.resolve, sums, min_weight, brightest, image, depth, weight, valid)
    if erode:
        valid = _eroded(valid)
    mask = valid.astype(np.float32)
    image *= mask
    depth *= mask
    return Warped(*(torch.from_numpy(array) for array in (image, mask, depth, weight)))


def _eroded(valid: np.ndarray) -> np.ndarray:
    """`valid` [H, W] less its pixels next to a hole (4-neighbourhood).

    Neither the frame's border nor a lone hole (its four neighbours all valid) counts, so that a pin
    hole stays one pixel instead of growing to five.
    """
    lone = _four_neighbours(valid, np.logical_and, outside=True)
    return valid & ~_four_neighbours(~valid & ~lone, np.logical_or, outside=False)


def _four_neighbours(x: np.ndarray, combine: np.ufunc, *, outside: bool) -> np.ndarray:
    """[H, W] bool: `combine` over the four neighbours of every pixel of x."""
    padded = np.pad(x, 1, constant_values=outside)
    vertical = combine(padded[:-2, 1:-1], padded[2:, 1:-1])
    return combine(vertical, combine(padded[1:-1, :-2], padded[1:-1, 2:]))


def _bilinear(x: Tensor) -> Tensor:
    """Twice the size, sampled at the new pixel centres."""
    for dim in (2, 3):
        n = x.shape[dim]
        before = torch.cat([x.narrow(dim, 0, 1), x.narrow(dim, 0, n - 1)], dim)
        after = torch.cat([x.narrow(dim, 1, n - 1), x.narrow(dim, n - 1, 1)], dim)
        fine = torch.stack([0.25 * before + 0.75 * x, 0.75 * x + 0.25 * after], dim + 1)
        x = fine.flatten(dim, dim + 1)
    return x
