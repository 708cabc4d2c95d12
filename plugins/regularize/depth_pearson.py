"""`reg=depth_pearson`: rendered depth should correlate with known depth.

FSGS (Zhu et al. 2024, arXiv 2312.00451, eq. 8): 1 - Pearson correlation over the pixels of a photo,
which ignores scale and offset. Known depth is that of `depth=`. FSGS also compares at unseen
cameras, with a network's depth of the render; this part is not implemented.
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
    """Options of `reg=depth_pearson`.

    Attributes:
        inverse: compare inverse depths, whose error is even over the image for stereo.
    """

    title: ClassVar[str] = "Pearson depth"
    paper: ClassVar[str] = "fsgs"

    defaults: ClassVar[dict[str, float]] = {"weight": 0.05}

    inverse: bool = False

    def loss(self, ctx: StepContext, state: Any, view: View, render: Render) -> Tensor | None:
        """1 - correlation over the pixels of known depth where something is rendered."""
        reference = known_depth(ctx, view)
        if reference is None:
            return None
        depth, valid = reference
        valid = valid & (render.alpha.detach() > SEEN)
        if int(valid.sum()) < FEWEST:
            return None
        pair = render.expected_depth[valid], depth[valid]
        if self.inverse:
            pair = 1 / pair[0].clamp(min=SEEN), 1 / pair[1]
        return 1 - correlation(*pair)
