"""`reg=frequency`: limit how small Gaussians may be, one octave after another.

FreeNeRF (Yang et al. 2023, section 3.3) hides the high frequencies of a NeRF's positional encoding
and opens its octaves linearly until nine tenths of the training. Gaussians have no encoding; the
counterpart is their smallest size. A Gaussian of standard deviation s pixels has the spectrum
exp(-2 pi^2 s^2 f^2), which falls by exp(-1/2) at f = 1 / (2 pi s). That is 1 / pi pixels for the
finest frequency of a photo (half a cycle per pixel), and twice as much for an octave less.

The loss is the squared logarithm of the ratio by which a Gaussian is too small.
`trainer.coarse_octaves` does the same to the photos, and `trainer.sh_every` to colours;
`method=freenerf` has all three.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from framework.plugin import Regularizer, StepContext, register

if TYPE_CHECKING:
    from torch import Tensor

    from framework.types import Render, View

FINEST = 1 / math.pi  # pixels


@register("reg", "frequency")
@dataclass(frozen=True)
class Frequency(Regularizer):
    """Options of `reg=frequency`.

    Attributes:
        octaves: number of octaves that are closed at first.
        opened: share of the training after which all are open (FreeNeRF: 0.9 for 3 photos, 0.7 for
            6, 0.5 for 9).
    """

    title: ClassVar[str] = "Frequency"
    paper: ClassVar[str] = "freenerf"

    defaults: ClassVar[dict[str, float]] = {"weight": 0.1}

    octaves: float = 3.0
    opened: float = 0.9

    def __post_init__(self) -> None:
        self.check("octaves", 0 < self.octaves <= 10, "a number in (0, 10]")
        self.check("opened", 0 < self.opened <= 1, "a share in (0, 1]")

    def limit(self, progress: float) -> float:
        """Pixels of the photo at full size: the smallest standard deviation that is free."""
        closed = self.octaves * max(0.0, 1 - progress / self.opened)
        return float(FINEST * 2.0**closed)

    def loss(self, ctx: StepContext, state: Any, view: View, render: Render) -> Tensor | None:
        """Mean over the Gaussians in view of max(0, log limit - log s)^2, s their middle standard
        deviation: that of a disc which faces the camera, across its narrower side."""
        import torch

        from framework.compute.portable import log
        from framework.geometry import project

        seen = render.radii > 0
        if view.pseudo or ctx.progress >= self.opened or not seen.any():
            return None
        camera = view.camera
        _, z = project(ctx.gaussians.means.detach(), camera)
        z = z.clamp(min=ctx.near)[seen]
        # the view may be smaller than its photo: pixels are those of the photo
        widths = {photo.name: photo.camera.width for photo in ctx.views}
        focal_px = float(camera.K[0, 0]) * widths[view.name] / camera.width
        limit = torch.from_numpy(log(self.limit(ctx.progress) * z / focal_px)).to(z.dtype)
        middle = ctx.gaussians.log_scales[seen].sort(1).values[:, 1]
        return (limit - middle).clamp(min=0).square().mean()
