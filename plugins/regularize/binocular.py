"""`reg=binocular`: a render from a shifted camera, warped back by depth, should match the photo.

Binocular-Guided 3DGS (Han et al. 2024, arXiv 2410.18822, section 3.1). The camera is moved by t
along its x axis. The render there is warped into the photo by the disparity -f t / D of the photo's
rendered depth D. The loss is the mean over all pixels of |mask (warped - photo)|, with gradients
into both renders.

Its code also smooths the disparity, by the mean of exp(-0.33 |dI|) |d(mask d)| along each axis,
with dI the sum over channels of central differences. The text does not mention it. The trainer
has a variant, `trainer.binocular`, see `framework.train.depth_priors`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from framework.plugin import Regularizer, StepContext, register
from framework.toolbox.elsewhere import seen_through

if TYPE_CHECKING:
    from torch import Tensor

    from framework.types import Render, View

NEAREST = 1e-5  # scene units
EDGE = 0.33  # how fast smoothing fades with a step of the image, whose values are in [0, 1]


@register("reg", "binocular")
@dataclass(frozen=True)
class Binocular(Regularizer):
    """Options of `reg=binocular`.

    Attributes:
        shift: largest move of the camera, in mean distances to the next camera.
        smooth: weight of the disparity's smoothness, in pixels.
    """

    title: ClassVar[str] = "Binocular"
    paper: ClassVar[str] = "binocular"

    # the last third of 30,000 steps
    defaults: ClassVar[dict[str, float]] = {"start": 0.667}

    shift: float = 0.4
    smooth: float = 0.0

    def __post_init__(self) -> None:
        self.check("shift", 0 < self.shift <= 10, "a number in (0, 10]")
        self.check("smooth", self.smooth >= 0, "a number >= 0")

    def loss(self, ctx: StepContext, state: Any, view: View, render: Render) -> Tensor | None:
        """Mean absolute difference of the warped render and the photo, over pixels and channels."""
        from framework.geometry import moved_aside

        if view.pseudo:
            return None
        t = self.shift * ctx.spacing * float(ctx.rng("shift").uniform(-1, 1))
        shifted = moved_aside(view.camera, t)
        other = ctx.render(shifted, ctx.gaussians, background=ctx.behind)
        depth = render.expected_depth
        warped, valid, _ = seen_through(other.rgb, depth, view.camera, shifted)
        if view.mask is not None:
            valid = valid & (view.mask > 0.5)
        loss = ((warped - view.image).abs() * valid).mean()
        if self.smooth > 0:
            focal = float(view.camera.K[0, 0])
            disparity = focal * abs(t) / depth.clamp(min=NEAREST) * valid
            loss = loss + self.smooth * roughness(disparity, view.image)
        return loss


def roughness(disparity: Tensor, image: Tensor) -> Tensor:
    """Mean of exp(-0.33 |step of the image|) |step of the disparity|, both axes."""
    from framework.compute.tensors import exp

    total = disparity.new_zeros(())
    for axis in (0, 1):
        edge = exp(-EDGE * image.diff(dim=axis + 1).abs().mean(0))
        total = total + (edge * disparity.diff(dim=axis).abs()).mean()
    return total
