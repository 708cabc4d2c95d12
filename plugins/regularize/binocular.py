"""`reg=binocular`: a render from beside a photo, moved back by its depth, should be the photo.

Binocular-Guided 3DGS (Han et al. 2024, arXiv 2410.18822, section 3.1): the camera is moved by t
along its own x axis; the render there, warped into the photo by the disparity -f t / D of the
photo's rendered depth D, is compared with the photo, mean over all pixels of |mask (warped -
photo)|. Its code also smooths the disparity, sum of exp(-0.33 |dI|) |d(mask d)| per pixel, which
the text does not say. Gradients go into both renders.

`agree` and `every` are ours. Where the two renders show different surfaces, the depth is wrong in
one of them, as at thin things near the camera, and the colour that is asked for would be painted on
what is behind: `agree` leaves such pixels out. `every` takes the second render in some steps only.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from framework.methods.elsewhere import seen_through
from framework.plugin import Regularizer, StepContext, register

if TYPE_CHECKING:
    from torch import Tensor

    from framework.types import Camera, Render, View

NEAREST = 1e-5  # scene units
EDGE = 0.33  # how fast smoothing fades with a step of the image, whose values are in [0, 1]


@register("reg", "binocular")
@dataclass(frozen=True)
class Binocular(Regularizer):
    """shift: largest move of the camera, in mean distances to the next camera. smooth: weight of
    the disparity's smoothness, in pixels. agree: pixels of disparity by which depths may differ
    where a pixel counts; 0: any. every: it acts in one of so many steps, so many times as much.
    """

    # the last third of 30,000 steps
    defaults: ClassVar[dict[str, float]] = {"start": 0.667}

    shift: float = 0.4
    smooth: float = 0.0
    agree: float = 0.0
    every: int = 1

    def __post_init__(self) -> None:
        self.check("shift", 0 < self.shift <= 10, "a number in (0, 10]")
        self.check("smooth", self.smooth >= 0, "a number >= 0")
        self.check("agree", self.agree >= 0, "pixels, 0 or more")
        self.check("every", self.every >= 1, "an integer >= 1")

    def rests(self, step: int) -> bool:
        return step % self.every > 0

    def loss(self, ctx: StepContext, state: Any, view: View, render: Render) -> Tensor | None:
        """Mean absolute difference of the warped render and the photo, over pixels and channels."""
        import torch

        from framework.geometry import mean_neighbour_distance

        if all(view.name != photo.name for photo in ctx.views):
            return None
        spacing = mean_neighbour_distance([v.camera for v in ctx.views]) or ctx.extent
        t = self.shift * spacing * float(ctx.rng("shift").uniform(-1, 1))
        beside = moved(view.camera, t)
        other = ctx.render(beside, ctx.gaussians, background=ctx.behind)
        depth = render.expected_depth
        seen = other.rgb
        if self.agree > 0:
            seen = torch.cat([seen, other.expected_depth.detach()[None]])
        warped, valid, there = seen_through(seen, depth, view.camera, beside)
        focal = float(view.camera.K[0, 0])
        if self.agree > 0:
            apart = 1 / warped[3].clamp(min=NEAREST) - 1 / there.clamp(min=NEAREST)
            valid = valid & (focal * spacing * apart.detach().abs() < self.agree)
        if view.mask is not None:
            valid = valid & (view.mask > 0.5)
        loss = ((warped[:3] - view.image).abs() * valid).mean()
        if self.smooth > 0:
            disparity = focal * abs(t) / depth.clamp(min=NEAREST) * valid
            loss = loss + self.smooth * roughness(disparity, view.image)
        return self.every * loss


def moved(camera: Camera, t: float) -> Camera:
    """`camera` with its centre at t (scene units) along its own x axis."""
    from framework.types import Camera

    viewmat = camera.viewmat.clone()
    viewmat[0, 3] -= t
    return Camera(viewmat, camera.K, camera.width, camera.height)


def roughness(disparity: Tensor, image: Tensor) -> Tensor:
    """Mean of exp(-0.33 |step of the image|) |step of the disparity|, both axes."""
    total = disparity.new_zeros(())
    for axis in (0, 1):
        edge = (-EDGE * image.diff(dim=axis + 1).abs().mean(0)).exp()
        total = total + (edge * disparity.diff(dim=axis).abs()).mean()
    return total
