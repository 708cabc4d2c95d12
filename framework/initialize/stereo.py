"""`init=stereo`: Gaussians sampled from the fused, consistent depth of the training views.

Only depth that passed its consistency check (confidence > 0) is used. A few Gaussians are placed on
a guessed surface elsewhere (see `completion`). Photographs get more Gaussians where they have
detail, and each is as large as the patch of pixels that it represents.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from framework.errors import check_option, require

if TYPE_CHECKING:
    from framework.types import DepthMap, Gaussians, TrainingSet

FEWEST_PIXELS = 100
LARGEST_BUDGET = 100_000  # of those that are not set by hand


@dataclass(frozen=True)
class Stereo:
    """How the depth maps become Gaussians.

    Attributes:
        budget: number of Gaussians; 0 = `per_pixel` times the training pixels. There are fewer if
            fusion leaves fewer pixels.
        per_pixel: Gaussians per training pixel, if budget is 0. At most 100,000 in all; 0.07 gives
            40,000 for three photos of 504x378.
        detail: exponent of the local image gradient in the sampling density; 0 = uniform.
        tolerance: relative depth difference up to which two views show the same surface.
        scale_factor: standard deviation in units of the mean spacing of the samples.
        opacity: of every Gaussian.
        completion: sampling density of pixels with guessed depth, relative to consistent ones; 0 =
            none.
    """

    budget: int = 0
    per_pixel: float = 0.07
    detail: float = 0.5
    tolerance: float = 0.03
    scale_factor: float = 1.1
    opacity: float = 0.1
    completion: float = 0.1

    def __post_init__(self) -> None:
        check = functools.partial(check_option, self, "init")
        check("budget", self.budget >= 0, "an integer >= 0")
        check("per_pixel", 0 < self.per_pixel <= 1, "a number in (0, 1]")
        check("detail", 0 <= self.detail <= 4, "a number in [0, 4]")
        check("tolerance", 0 < self.tolerance < 1, "a relative difference in (0, 1)")
        check("scale_factor", 0 < self.scale_factor < 100, "a number in (0, 100)")
        check("opacity", 0 < self.opacity < 1, "a number in (0, 1)")
        check("completion", 0 <= self.completion <= 1, "a number in [0, 1]")

    def build(
        self, training: TrainingSet, depth: tuple[DepthMap, ...], sh_degree: int, seed: int
    ) -> Gaussians:
        """Place round Gaussians on the fused depth.

        Sample i with sampling probability p_i represents 1 / p_i pixels, so its standard deviation
        is scale_factor * pixel size / sqrt(p_i).

        Raises:
            UserError: if fewer than 100 pixels have consistent depth.
        """
        import numpy as np

        from framework.compute.rng import stream
        from framework.initialize.completion import complete
        from framework.initialize.fusion import fuse, joined, mapped
        from framework.initialize.isotropic import isotropic_gaussians
        from framework.initialize.sampling import draw, inclusion_probabilities

        maps = mapped(training, depth, self.detail)
        pixels = fuse(maps, self.tolerance)
        require(
            len(pixels.xyz) >= FEWEST_PIXELS,
            f"init=stereo: expected at least {FEWEST_PIXELS} pixels with consistent depth in scene"
            f" {training.scene}, got {len(pixels.xyz)}; use init=sparse or another depth",
        )
        if self.completion > 0:
            guess = complete(maps, self.tolerance)
            pixels = joined([pixels, replace(guess, density=self.completion * guess.density)])
        probability = inclusion_probabilities(pixels.density, self._budget(training))
        chosen = draw(probability, stream(seed, "init/stereo"))
        scales = self.scale_factor * pixels.size[chosen] / np.sqrt(probability[chosen])
        return isotropic_gaussians(
            pixels.xyz[chosen], pixels.rgb[chosen], scales, self.opacity, sh_degree
        )

    def _budget(self, training: TrainingSet) -> int:
        if self.budget > 0:
            return self.budget
        pixels = sum(view.camera.width * view.camera.height for view in training.views)
        return min(max(1, round(self.per_pixel * pixels)), LARGEST_BUDGET)
