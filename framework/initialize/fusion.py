"""Fuses depth maps to one set of surface pixels, each surface once.

Views are processed from the most central to the outermost one. A pixel enters if

- its depth is confident and its view's mask valid,
- no earlier view shows the same surface (depth there equal within `tolerance`), and
- at least as many other views agree with it as look through it, i.e. measure a depth clearly
  behind it (free-space violation). The nearest depth of 3 x 3 pixels decides, so that rounding to
  whole pixels at thin foreground objects is no violation.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import partial

import numpy as np
import torch

from framework.compute.parallel import run_tasks
from framework.initialize.sampling import detail_density
from framework.initialize.sight import Sights, sights, unrepeated
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
class Mapped:
    """The training views with their depth, from the most central to the outermost one.

    Attributes:
        order: their indices in `training`.
        seen: their confident depth.
        density: of each, [H, W] float64, see `sampling.detail_density`.
    """

    training: TrainingSet
    order: tuple[int, ...]
    seen: Sights
    density: tuple[np.ndarray, ...]

    @property
    def views(self) -> list[View]:
        """Return the training views in this order."""
        return [self.training.views[i] for i in self.order]


def mapped(training: TrainingSet, depth: Sequence[DepthMap], detail: float) -> Mapped:
    """Order the views and their depth maps."""
    order = by_centrality([view.camera for view in training.views])
    views = [training.views[i] for i in order]
    density = run_tasks([partial(detail_density, view.image.numpy(), detail) for view in views])
    return Mapped(training, tuple(order), sights(views, [depth[i] for i in order]), tuple(density))


def fuse(maps: Mapped, tolerance: float) -> SurfacePixels:
    """The surface pixels of all training views."""
    parts = []
    for v in range(len(maps.order)):
        places, chosen = unrepeated(maps.seen, v, tolerance)
        parts.append(surface_pixels(maps, v, places, maps.seen.image(maps.seen.depth, v), chosen))
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


def surface_pixels(
    maps: Mapped, v: int, places: np.ndarray, depth: np.ndarray, chosen: np.ndarray
) -> SurfacePixels:
    """The pixels `chosen` [H, W] of a view, at places [H, W, 3] and depth [H, W]."""
    view = maps.views[v]
    focal_px = math.sqrt(float(view.camera.K[0, 0] * view.camera.K[1, 1]))
    rgb = view.image.numpy()[:, chosen].T
    return SurfacePixels(places[chosen], rgb, depth[chosen] / focal_px, maps.density[v][chosen])
