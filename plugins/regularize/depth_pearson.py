"""`reg=depth_pearson`: rendered depth should be correlated with the known one.

FSGS (Zhu et al. 2024, arXiv 2312.00451, eq. 8): 1 - Pearson's correlation over the pixels of a
photo. It is invariant to scale and offset, so the depth may be a network's or, by default, the
plane sweep's. FSGS also compares unseen cameras with a network's depth of the render, which is left
out here.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from framework.plugin import Regularizer, StepContext, register
from framework.toolbox.elsewhere import SEEN, correlation, known_depth

if TYPE_CHECKING:
    from torch import Tensor

    from framework.types import Render, View

FEWEST = 16  # pixels


@register("reg", "depth_pearson")
@dataclass(frozen=True)
class DepthPearson(Regularizer):
    """inverse: compare inverse depths, whose noise is even over the image for a matcher."""

    defaults: ClassVar[dict[str, float]] = {"weight": 0.05}

    inverse: bool = False

    def loss(self, ctx: StepContext, state: Any, view: View, render: Render) -> Tensor | None:
        """1 - correlation over the pixels of known depth where something is rendered."""
        known = known_depth(ctx, view)
        if known is None:
            return None
        depth, valid = known
        valid = valid & (render.alpha.detach() > SEEN)
        if int(valid.sum()) < FEWEST:
            return None
        pair = render.expected_depth[valid], depth[valid]
        if self.inverse:
            pair = 1 / pair[0].clamp(min=SEEN), 1 / pair[1]
        return 1 - correlation(*pair)
