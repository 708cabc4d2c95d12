"""`reg=patch_smoothness`: smooth depth in small patches of unseen views.

RegNeRF (Niemeyer et al. 2022, section 3.2 and its code): the sum over 8 x 8 patches of the squared
differences of neighbouring depths, times the patch's coverage (without a gradient). Its weight
falls from a large value over the first 512 of 70,000 steps. Depth is in scene extents here, and
cameras lie between training cameras, since evaluation poses may not be used.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from framework.plugin import Regularizer, StepContext, register
from framework.toolbox.elsewhere import unseen_camera

if TYPE_CHECKING:
    from torch import Tensor

    from framework.types import Render, View


@register("reg", "patch_smoothness")
@dataclass(frozen=True)
class PatchSmoothness(Regularizer):
    """Options of `reg=patch_smoothness`.

    Attributes:
        patch: patch size in pixels.
        initial: weight in the first step relative to the last (RegNeRF: 4000); the default 1 is
            constant.
        falling: share of the training over which it decays, exponentially.
    """

    title: ClassVar[str] = "Patch smoothness"
    paper: ClassVar[str] = "regnerf"

    defaults: ClassVar[dict[str, float]] = {"weight": 0.1}

    patch: int = 8
    initial: float = 1.0
    falling: float = 0.01

    def __post_init__(self) -> None:
        self.check("patch", self.patch >= 2, "an integer >= 2")
        self.check("initial", 1 <= self.initial <= 1e6, "a number in [1, 1e6]")
        self.check("falling", 0 < self.falling <= 1, "a share in (0, 1]")

    def loss(self, ctx: StepContext, state: Any, view: View, render: Render) -> Tensor | None:
        """Mean over the patches of an unseen camera's image."""
        if view.pseudo:
            return None
        camera = unseen_camera(ctx, ctx.rng("camera"), view.camera)
        seen = ctx.render(camera, ctx.gaussians, background=ctx.behind)
        done = min(1.0, ctx.progress / self.falling)
        factor = self.initial ** (1 - done)
        return factor * roughness(seen.expected_depth / ctx.extent, seen.alpha, self.patch)


def roughness(depth: Tensor, alpha: Tensor, patch: int) -> Tensor:
    """Mean roughness of whole patches of an image [H, W], times its alpha.

    A patch's roughness is the mean over its pixels, without the last row and column, of
    (d_ij - d_i,j+1)^2 + (d_ij - d_i+1,j)^2. Pairs with a pixel that shows nothing do not count.
    """
    from framework.toolbox.elsewhere import SEEN

    rows, columns = (n // patch * patch for n in depth.shape)
    if rows == 0 or columns == 0:
        return depth.sum() * 0

    def cut(values: Tensor) -> Tensor:
        return values[:rows, :columns].reshape(rows // patch, patch, columns // patch, patch)

    tiles, weights, shown = cut(depth), cut(alpha.detach()), cut(alpha > SEEN)
    coverage = weights[:, :-1, :, :-1] * shown[:, :-1, :, :-1]
    down = (tiles[:, 1:, :, :-1] - tiles[:, :-1, :, :-1]).square() * shown[:, 1:, :, :-1]
    right = (tiles[:, :-1, :, 1:] - tiles[:, :-1, :, :-1]).square() * shown[:, :-1, :, 1:]
    mean: Tensor = ((down + right) * coverage).mean()
    return mean
