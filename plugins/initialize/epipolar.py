"""`init=epipolar`: one Gaussian per pixel whose match lies on its epipolar line.

NexusGS (Zheng et al. 2025): a pixel is matched with its two nearest views. The match is moved onto
its epipolar line, or refused if it is a pixel or more away. Of two depths the one is kept that a
small error of the match changes less.

NexusGS matches by optical flow, a network. Here a pair of views is matched by the plane sweep,
which gives depth, and then freely, by the best correlation within a few pixels. Matches off the
line are refused, and both views have to agree, since the search is short.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from framework.errors import require
from framework.plugin import Initializer, register

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np

    from framework.types import Camera, DepthMap, Gaussians, TrainingSet

FEWEST = 100  # pixels with a match
REACH = 2  # pixels around the swept match that are searched


@register("init", "epipolar")
@dataclass(frozen=True)
class Epipolar(Initializer):
    """Gaussians on pixels with a match on the epipolar line."""

    title: ClassVar[str] = "Epipolar"
    paper: ClassVar[str] = "nexusgs"

    partners: int = 2  # number of nearest views to match with
    off_line: float = 1.0  # distance from the epipolar line, in pixels, that rejects a match
    similar: float = 0.3  # least correlation of the matched windows
    tolerance: float = 0.03  # largest relative depth difference between the two views of a pair
    share: float = 0.2  # random share of the matched pixels that become Gaussians; 1 = all
    radius: int = 3  # of the compared window, in pixels
    scale_factor: float = 1.0  # standard deviation in units of the mean spacing
    opacity: float = 0.1  # of every Gaussian

    def __post_init__(self) -> None:
        self.check("partners", 1 <= self.partners <= 100, "an integer from 1 to 100")
        self.check("off_line", 0 < self.off_line <= 10, "pixels in (0, 10]")
        self.check("similar", -1 <= self.similar <= 1, "a correlation in [-1, 1]")
        self.check("tolerance", 0 < self.tolerance < 1, "a share in (0, 1)")
        self.check("share", 0 < self.share <= 1, "a share in (0, 1]")
        self.check("radius", 1 <= self.radius <= 15, "1 to 15 pixels")
        self.check("scale_factor", 0 < self.scale_factor < 100, "a number in (0, 100)")
        self.check("opacity", 0 < self.opacity < 1, "a number in (0, 1)")

    def build(
        self, training: TrainingSet, depth: tuple[DepthMap, ...], sh_degree: int, seed: int
    ) -> Gaussians:
        """Make round Gaussians on the matched pixels, as large as the pixels they represent.
        `depth` is not used.

        Raises:
            UserError: when hardly any pixel has a match.
        """
        import numpy as np
        import torch

        from framework.compute.rng import stream
        from framework.geometry import unproject
        from framework.initialize.isotropic import isotropic_gaussians

        places, colours, sizes = [], [], []
        for view, z in zip(training.views, self.depths(training), strict=True):
            valid = z > 0
            if view.mask is not None:
                valid &= view.mask.numpy() > 0.5
            at = unproject(torch.from_numpy(z), view.camera).numpy()
            K = view.camera.K
            places.append(at[valid])
            colours.append(view.image.numpy()[:, valid].T)
            sizes.append(z[valid] / math.sqrt(float(K[0, 0] * K[1, 1])))
        xyz, rgb, size = (np.concatenate(parts) for parts in (places, colours, sizes))
        require(
            len(xyz) >= FEWEST,
            f"init=epipolar: expected at least {FEWEST} pixels with a match on their epipolar line"
            f" in scene {training.scene}, got {len(xyz)}; use init=sparse, init=stereo, a larger"
            " init.off_line or views that overlap more",
        )
        n = max(FEWEST, round(self.share * len(xyz)))
        chosen = np.sort(stream(seed, "init/epipolar").permutation(len(xyz))[:n])
        scales = self.scale_factor * size[chosen] * np.sqrt(len(xyz) / len(chosen))
        return isotropic_gaussians(xyz[chosen], rgb[chosen], scales, self.opacity, sh_degree)

    def depths(self, training: TrainingSet) -> list[np.ndarray]:
        """[H, W] float64 of every view: the depth of the match that is least sensitive, 0 = none.

        Raises:
            UserError: as `depth=plane_sweep` does, where views are too few or too small.
        """
        from framework.depth.consistency import agreeing_views
        from framework.depth.matching.sweep import checked, grey, sweep_view
        from framework.depth.options import PlaneSweepOptions

        options = PlaneSweepOptions(radius=self.radius, tolerance=self.tolerance)
        pairs = checked(training, options, self.partners)
        images = [grey(view) for view in training.views]
        cameras = [view.camera for view in training.views]
        bounds = [bound for bound, _ in pairs]
        wanted = {(i, j) for i, (_, partners) in enumerate(pairs) for j in partners}
        swept = {
            (i, j): sweep_view(training, images, i, [j], bounds[i], options)[0]
            for i, j in sorted(wanted | {(j, i) for i, j in wanted})
        }
        maps = []
        for i, (_, partners) in enumerate(pairs):
            matches = []
            for j in partners:
                pair = [swept[i, j], swept[j, i]], [cameras[i], cameras[j]]
                agreed = agreeing_views(*pair, 0, [1], self.tolerance) > 0
                z = swept[i, j] * agreed
                matches.append(self._on_line(z, images[i], images[j], cameras[i], cameras[j]))
            maps.append(least_sensitive(matches, images[i].shape))
        return maps

    def _on_line(
        self, z: np.ndarray, image: np.ndarray, other: np.ndarray, camera: Camera, source: Camera
    ) -> tuple[np.ndarray, np.ndarray]:
        """Move the free match onto the epipolar line.

        Returns:
            Its depth [H, W], 0 where it is refused, and the depth's relative change for a pixel
            along the line [H, W].
        """
        import numpy as np

        line = Line.of(z, camera, source)
        moved, alike = free_match(image, other, line.u, line.v, self.radius)
        along = moved[0] * line.du + moved[1] * line.dv
        across = moved[0] * line.dv - moved[1] * line.du
        kept = (z > 0) & (np.abs(across) < self.off_line) & (alike >= self.similar)
        depth = np.where(kept, z + along * line.dz, 0.0)
        depth = np.where(depth > 0, depth, 0.0)
        return depth, np.abs(line.dz) / np.maximum(depth, 1e-300)


@dataclass(frozen=True)
class Line:
    """Epipolar lines of a view's pixels in another view, at their matches; all [H, W].

    Attributes:
        u, v: the match, pixels.
        du, dv: unit direction of the line, towards larger depth.
        dz: change of depth per pixel along it.
    """

    u: np.ndarray
    v: np.ndarray
    du: np.ndarray
    dv: np.ndarray
    dz: np.ndarray

    @classmethod
    def of(cls, z: np.ndarray, camera: Camera, source: Camera) -> Line:
        """Derivative at depth z [H, W]: with p(z) = z A x + t, a = A x and u = p_0 / p_2,
        du/dz = (a_0 p_2 - p_0 a_2) / p_2^2 (`framework.depth.transfer`).
        """
        import numpy as np

        from framework.depth.transfer import pixel_transfer

        A, t = pixel_transfer(camera, source)
        y, x = np.mgrid[: z.shape[0], : z.shape[1]] + 0.5
        a = [A[k, 0] * x + A[k, 1] * y + A[k, 2] for k in range(3)]
        depth = np.where(z > 0, z, 1.0).astype(np.float64)
        p = [depth * a[k] + t[k] for k in range(3)]
        last = np.where(np.abs(p[2]) > 1e-12, p[2], 1e-12)
        slope = [(a[k] * last - p[k] * a[2]) / (last * last) for k in (0, 1)]
        length = np.maximum(np.sqrt(slope[0] ** 2 + slope[1] ** 2), 1e-12)
        return cls(p[0] / last, p[1] / last, slope[0] / length, slope[1] / length, 1 / length)


def free_match(
    image: np.ndarray, other: np.ndarray, u: np.ndarray, v: np.ndarray, radius: int
) -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray]:
    """Find every pixel's best match around (u, v) in `other`, at most `REACH` pixels away each way.

    Windows are warped by (u, v), so that slanted surfaces keep their form.

    Returns:
        The offsets ([H, W] each way, subpixel) and the correlation [H, W].
    """
    import numpy as np

    from framework.depth.matching.sweep import zncc

    n, grey = 2 * REACH + 1, image.astype(np.float64)
    scores = np.stack(
        [
            zncc(grey, sampled(other, u + dx, v + dy), radius)
            for dy in range(-REACH, REACH + 1)
            for dx in range(-REACH, REACH + 1)
        ]
    ).reshape(n, n, *image.shape)
    best = scores.reshape(n * n, *image.shape).argmax(0)
    row, column = best // n, best % n
    y, x = np.indices(image.shape)

    def score(i: np.ndarray, j: np.ndarray) -> np.ndarray:
        chosen: np.ndarray = scores[np.clip(i, 0, n - 1), np.clip(j, 0, n - 1), y, x]
        return chosen

    top = score(row, column)
    finer = []
    for low, high, at in (
        (score(row, column - 1), score(row, column + 1), column),
        (score(row - 1, column), score(row + 1, column), row),
    ):
        bend = low - 2 * top + high
        inner = (at > 0) & (at < n - 1) & (bend < 0)
        finer.append(at - REACH + np.where(inner, 0.5 * (low - high) / np.minimum(bend, -1e-12), 0))
    return (finer[0], finer[1]), top


def sampled(image: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """`image` [h, w] at pixels (u, v), bilinearly; its border is repeated."""
    import numpy as np

    x = np.clip(u - 0.5, 0, image.shape[1] - 1.000001)
    y = np.clip(v - 0.5, 0, image.shape[0] - 1.000001)
    column, row = x.astype(np.int64), y.astype(np.int64)
    fx, fy = x - column, y - row
    top = image[row, column] * (1 - fx) + image[row, column + 1] * fx
    low = image[row + 1, column] * (1 - fx) + image[row + 1, column + 1] * fx
    values: np.ndarray = top * (1 - fy) + low * fy
    return values


def least_sensitive(
    matches: Sequence[tuple[np.ndarray, np.ndarray]], shape: tuple[int, ...]
) -> np.ndarray:
    """[H, W] of (depth, sensitivity) pairs the depth, where there is one, whose sensitivity is the
    smallest; 0 where there is none."""
    import numpy as np

    depth, least = np.zeros(shape), np.full(shape, np.inf)
    for candidate, sensitivity in matches:
        better = (candidate > 0) & (sensitivity < least)
        depth, least = np.where(better, candidate, depth), np.where(better, sensitivity, least)
    return depth
