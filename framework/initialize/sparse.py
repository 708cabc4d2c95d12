"""`init=sparse`: one Gaussian per triangulated point that training views support.

As in 3DGS (Kerbl et al. 2023, section 5.1 and its code), the standard deviation is the root mean
squared distance to the 3 nearest other points. The opacity is 0.1, without rotation.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import TYPE_CHECKING

from framework.errors import check_option, require

if TYPE_CHECKING:
    import numpy as np

    from framework.types import DepthMap, Gaussians, TrainingSet

NEIGHBOURS = 3
SMALLEST_SCALE = 1e-4  # in scene extents; keeps coinciding points from becoming points of size 0


@dataclass(frozen=True)
class Sparse:
    """Options of `init=sparse`.

    Attributes:
        scale_factor: multiplies the neighbour distance.
        opacity: of every Gaussian.
    """

    scale_factor: float = 1.0
    opacity: float = 0.1

    def __post_init__(self) -> None:
        check = functools.partial(check_option, self, "init")
        check("scale_factor", 0 < self.scale_factor < 100, "a number in (0, 100)")
        check("opacity", 0 < self.opacity < 1, "a number in (0, 1)")

    def build(
        self, training: TrainingSet, depth: tuple[DepthMap, ...], sh_degree: int, seed: int
    ) -> Gaussians:
        """Create one Gaussian per point of `training.points`; depth and seed are ignored.

        Raises:
            UserError: when there are too few points for neighbour distances.
        """
        from framework.initialize.isotropic import isotropic_gaussians

        points = training.points
        require(
            len(points.xyz) > NEIGHBOURS,
            f"init=sparse: expected more than {NEIGHBOURS} triangulated points that two training"
            f" views share in scene {training.scene}, got {len(points.xyz)}; use init=stereo or"
            " more views (scene.n_views)",
        )
        xyz = points.xyz.numpy()
        scales = self.scale_factor * neighbour_scales(xyz, SMALLEST_SCALE * training.extent)
        return isotropic_gaussians(xyz, points.rgb.numpy(), scales, self.opacity, sh_degree)


def neighbour_scales(xyz: np.ndarray, smallest: float) -> np.ndarray:
    """[M] root mean squared distance to the 3 nearest other points, at least `smallest`.

    Args:
        xyz: [M, 3], M > 3, scene units.
    """
    import numpy as np
    from scipy.spatial import cKDTree

    distances, _ = cKDTree(xyz).query(xyz, k=NEIGHBOURS + 1)  # the nearest is the point itself
    return np.maximum(np.sqrt(np.square(distances[:, 1:]).mean(1)), smallest)
