"""`reg=depth_local_global`: patchwise match of normalized depth (DNGaussian).

DNGaussian (Li et al. 2024, arXiv 2403.06912). Before the update on the photo, one step of the
optimizer moves the centres alone, with all opacities at 0.95 ("hard" depth). Another moves the
opacities alone ("soft" depth). Rendered and known depth are compared in patches of a random size.
They are centred by the patch's mean and divided by the patch's deviation (local) or the image's
(global).

The loss is 0.1 local + 1 global, with the mean over residuals above a margin of their squares (its
code for a dense start: a margin of 0.01; in DropoutGS 0.1 global). Known depth is that of `depth=`;
only its relative values in a patch count.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from framework.plugin import Regularizer, StepContext, SubStep, register
from framework.toolbox.elsewhere import SEEN, known_depth

if TYPE_CHECKING:
    from torch import Tensor

    from framework.types import View

HARD = 0.95  # opacity of all in the hard render
LOCAL = 0.1
SHARE = 0.01  # of the image's deviation that a patch's is kept above


@register("reg", "depth_local_global")
@dataclass(frozen=True)
class DepthLocalGlobal(Regularizer):
    """Options of `reg=depth_local_global`.

    Attributes:
        smallest, largest: patch size in pixels, drawn uniformly.
        margin: smaller residuals do not count.
        whole: weight of the global loss.
        soft_from: share of the training before which only means move.
    """

    title: ClassVar[str] = "DNGaussian depth"
    paper: ClassVar[str] = "dngaussian"

    defaults: ClassVar[dict[str, float]] = {"weight": 1.0}

    smallest: int = 5
    largest: int = 17
    margin: float = 2.5e-4
    whole: float = 1.0
    soft_from: float = 0.167

    def __post_init__(self) -> None:
        self.check("smallest", self.smallest >= 2, "an integer >= 2")
        self.check("largest", self.largest >= self.smallest, "an integer >= smallest")
        self.check("margin", self.margin >= 0, "a number >= 0")
        self.check("whole", self.whole >= 0, "a number >= 0")
        self.check("soft_from", 0 <= self.soft_from <= 1, "a share in [0, 1]")

    def substeps(self, ctx: StepContext, state: Any, view: View) -> Iterator[SubStep]:
        reference = known_depth(ctx, view)
        if reference is None:
            return
        rng = ctx.rng("patches")
        names = [("means",)] + [("opacity_logits",)] * (ctx.progress >= self.soft_from)
        for moved in names:
            loss = self._loss(
                ctx, view, moved[0], reference, int(rng.integers(self.smallest, self.largest + 1))
            )
            if loss is not None:
                yield loss, moved

    def _loss(
        self, ctx: StepContext, view: View, moved: str, reference: tuple[Tensor, Tensor], patch: int
    ) -> Tensor | None:
        """The loss of one render in which only the parameter `moved` has a gradient."""
        import torch

        gaussians = ctx.gaussians.detach().replace(**{moved: getattr(ctx.gaussians, moved)})
        if moved == "means":
            logit = math.log(HARD / (1 - HARD))
            opaque = torch.full_like(gaussians.opacity_logits, logit)
            gaussians = gaussians.replace(opacity_logits=opaque)
        seen = ctx.render(view.camera, gaussians)
        valid = reference[1] & (seen.alpha.detach() > SEEN)
        return compared(seen.expected_depth, reference[0], valid, patch, self.margin, self.whole)


def compared(
    rendered: Tensor, reference: Tensor, valid: Tensor, patch: int, margin: float, whole: float
) -> Tensor | None:
    """0.1 local + `whole` global loss of two depth maps [H, W] over whole patches of `valid`
    pixels; None without any such patch."""
    rows, columns = (n // patch for n in rendered.shape)
    if rows == 0 or columns == 0:
        return None

    def tiles(values: Tensor) -> Tensor:
        cut = values[: rows * patch, : columns * patch]
        return cut.reshape(rows, patch, columns, patch).transpose(1, 2).reshape(-1, patch**2)

    inside = tiles(valid).all(1)
    if not inside.any():
        return None
    loss = rendered.new_zeros(())
    pair = [tiles(values)[inside] for values in (rendered, reference)]
    spread = [values.std().detach() for values in pair]
    for weight, local in ((LOCAL, True), (whole, False)):
        normal = []
        for values, deviation in zip(pair, spread, strict=True):
            centred = values - values.mean(1, keepdim=True)
            by = values.std(1, keepdim=True) if local else deviation
            normal.append(centred / (by + SHARE * deviation + 1e-12))
        residual = (normal[0] - normal[1]).abs()
        counted = residual > margin
        squares = (residual.square() * counted).sum() / counted.sum().clamp(min=1)
        loss = loss + weight * squares
    return loss if loss.requires_grad else None
