"""Many depth maps to one set of surface pixels, each surface once.

Views are taken from the most central to the outermost one. A pixel enters when

- its depth is confident and its view's mask valid,
- no earlier view shows the same surface (depth there equal within `tolerance`), and
- at least as many other views agree with it as look through it, i.e. measure a depth clearly
  behind it (free-space violation), judged by the nearest depth of 3 x 3 pixels, so that the
  rounding to whole pixels at thin foreground objects does not count as a violation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
import torch
from scipy.ndimage import minimum_filter
from torch import Tensor

from framework.geometry import project, unproject
from framework.initialize.sampling import detail_density
from framework.types import Camera, DepthMap, TrainingSet, View


@dataclass(frozen=True)
class SurfacePixels:
    """xyz: [P, 3] float64 world. rgb: [P, 3] float32. size: [P] float64, edge of the pixel's patch
    of surface in scene units, facing the camera. density: [P] float64, relative sampling density.
    """

    xyz: np.ndarray
    rgb: np.ndarray
    size: np.ndarray
    density: np.ndarray


@dataclass(frozen=True)
class DepthView:
    """A view's confident depth: depth [H, W] float64, 0 = none; nearest [H, W], the smallest depth
    of the 3 x 3 neighbours, infinite where none has any."""

    camera: Camera
    depth: Tensor
    nearest: Tensor


def fuse(
    training: TrainingSet, depth: tuple[DepthMap, ...], tolerance: float, detail: float
) -> SurfacePixels:
    """The surface pixels of all training views; `detail`: see `sampling.detail_density`.

    Raises ValueError when depth maps and views do not match in number or size.
    """
    if len(depth) != len(training.views):
        raise ValueError(
            f"fuse: expected one depth map per training view ({len(training.views)}), got"
            f" {len(depth)}"
        )
    order = by_centrality([view.camera for view in training.views])
    views = [training.views[i] for i in order]
    maps = [confident_view(training.views[i], depth[i]) for i in order]
    parts = [_added_pixels(i, views[i], maps, tolerance, detail) for i in range(len(views))]
    return joined(parts)


def joined(parts: Sequence[SurfacePixels]) -> SurfacePixels:
    """The pixels of several views, in order."""
    names = [field.name for field in fields(SurfacePixels)]
    return SurfacePixels(*(np.concatenate([getattr(p, name) for p in parts]) for name in names))


def by_centrality(cameras: list[Camera]) -> list[int]:
    """Indices from the camera nearest to the centroid of all to the farthest; ties keep order."""
    centers = torch.stack([camera.center for camera in cameras])
    distances = (centers - centers.mean(0)).norm(dim=1)
    # equal up to rounding is equal: the order must not hang on the last bit of the centroid
    relative = (distances / distances.max().clamp(min=1e-300)).round(decimals=9)
    return torch.argsort(relative, stable=True).tolist()


def confident_view(view: View, estimate: DepthMap) -> DepthView:
    """The depth that may be used, as float64."""
    valid = (estimate.confidence > 0) & (estimate.depth > 0) & torch.isfinite(estimate.depth)
    if view.mask is not None:
        valid &= view.mask > 0.5
    depth = torch.where(valid, estimate.depth, 0).to(torch.float64)
    near = np.where(valid.numpy(), depth.numpy(), np.inf)
    return DepthView(view.camera, depth, torch.from_numpy(minimum_filter(near, 3, mode="nearest")))


def _added_pixels(
    index: int, view: View, maps: list[DepthView], tolerance: float, detail: float
) -> SurfacePixels:
    """The pixels that view `index` of `maps` adds to those before."""
    own = maps[index]
    valid = own.depth > 0
    xyz, z = unproject(own.depth, own.camera)[valid], own.depth[valid]
    votes = torch.zeros(len(xyz), dtype=torch.int32)
    repeated = torch.zeros(len(xyz), dtype=torch.bool)
    for other, map_ in enumerate(maps):
        if other == index:
            continue
        agrees, violated = compare(xyz, map_, tolerance)
        votes += agrees.int() - violated.int()
        if other < index:
            repeated |= agrees
    new = (votes >= 0) & ~repeated
    chosen = valid.clone()
    chosen[valid] = new
    return surface_pixels(view, xyz[new], z[new], chosen, detail)


def surface_pixels(
    view: View, xyz: Tensor, z: Tensor, chosen: Tensor, detail: float
) -> SurfacePixels:
    """The pixels `chosen` [H, W] of a view, at xyz [P, 3] and depth z [P]."""
    focal_px = float((view.camera.K[0, 0] * view.camera.K[1, 1]).sqrt())
    density = detail_density(view.image.numpy(), detail)[chosen.numpy()]
    rgb = view.image.permute(1, 2, 0)[chosen]
    return SurfacePixels(xyz.numpy(), rgb.numpy(), (z / focal_px).numpy(), density)


def compare(xyz: Tensor, seen: DepthView, tolerance: float) -> tuple[Tensor, Tensor]:
    """[P] bool twice: `seen` measures the same surface at xyz [P, 3]; it looks through it."""
    camera = seen.camera
    uv, z = project(xyz, camera)
    inside = (z > 0) & (uv >= 0).all(1) & (uv[:, 0] < camera.width) & (uv[:, 1] < camera.height)
    column, row = torch.where(inside[:, None], uv, 0).long().unbind(1)
    depth, nearest = seen.depth[row, column], seen.nearest[row, column]
    agrees = inside & (depth > 0) & ((z - depth).abs() < tolerance * depth)
    violated = inside & nearest.isfinite() & (z < (1 - tolerance) * nearest)
    return agrees, violated
