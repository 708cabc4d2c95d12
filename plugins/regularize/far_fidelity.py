"""`reg=far_fidelity`: far pixels of the photo count twice.

D2GS (Song et al., ICLR 2026, distance-aware fidelity): L1 again over the 5 % of the pixels with the
largest depth. Its depth is a network's; here it is that of `depth=`, and pixels without depth do
not take part.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from framework.plugin import Regularizer, StepContext, register
from framework.toolbox.elsewhere import known_depth

if TYPE_CHECKING:
    from torch import Tensor

    from framework.types import Render, View


@register("reg", "far_fidelity")
@dataclass(frozen=True)
class FarFidelity(Regularizer):
    """Options of `reg=far_fidelity`.

    Attributes:
        share: of the pixels with known depth, the farthest, that count again.
    """

    title: ClassVar[str] = "DAFE"
    paper: ClassVar[str] = "d2gs"

    defaults: ClassVar[dict[str, float]] = {"weight": 1.0}

    share: float = 0.05

    def __post_init__(self) -> None:
        self.check("share", 0 < self.share <= 1, "a share in (0, 1]")

    def loss(self, ctx: StepContext, state: Any, view: View, render: Render) -> Tensor | None:
        """Mean absolute difference to the photo over the farthest pixels and the channels."""
        reference = known_depth(ctx, view)
        if reference is None:
            return None
        depth, valid = reference
        if view.mask is not None:
            valid = valid & (view.mask > 0.5)
        n = int(self.share * int(valid.sum()))
        if n == 0:
            return None
        least = depth[valid].topk(n).values[-1]
        far = valid & (depth >= least)
        return (render.rgb - view.image).abs()[:, far].mean()
