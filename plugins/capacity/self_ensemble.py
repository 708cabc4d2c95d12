"""`capacity=self_ensemble`: perturb a second field where renders are uncertain.

SE-GS (Zhao et al. 2025): a second field is trained with the model and perturbed now and then, and
the model is kept similar to it at unseen cameras (`reg=co_register`). Uncertain pixels are those
that changed most over the last three renders of the model from cameras between training cameras, at
a quarter of the size. The second field is not used for this, since its own noise would increase it.

In the largest 5 % of those pixels, if the change is above 0.01, Gaussians of the second field get
noise of a ratio that falls exponentially. It acts on opacity logits and on log-scales times their
mean size, and on means times the scene's extent (its code: the mean coordinate, at least 1). The
optimizer's moments stay. Combine it as `capacity=[adc,self_ensemble] reg=co_register`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from framework.plugin import Capacity, Edits, StepContext, StepStats, register
from framework.toolbox.elsewhere import unseen_camera

if TYPE_CHECKING:
    from torch import Tensor

    from framework.types import Camera, Gaussians, View

LOOKS = 3
BOX = 5  # pixels
SHAKEN = ("means", "log_scales", "opacity_logits")


@dataclass(frozen=True)
class Watched:
    """Renders for the uncertainty.

    Attributes:
        cameras: the unseen cameras.
        looks: the last renders of each, [L, 3, H, W].
    """

    cameras: tuple[Camera, ...]
    looks: tuple[Tensor, ...] = ()


@register("capacity", "self_ensemble")
@dataclass(frozen=True)
class SelfEnsemble(Capacity):
    """Perturbs the second field.

    A change is the standard deviation of the renders, mean of 5x5 pixels and the channels.
    """

    title: ClassVar[str] = "Self-ensembling"
    paper: ClassVar[str] = "segs"

    second_field: ClassVar[bool] = True
    defaults: ClassVar[dict[str, float]] = {"start": 0.05, "stop": 0.9}

    every: float = 0.05  # share of the training between two perturbations
    cameras: int = 24  # number of unseen cameras
    uncertain: float = 0.05  # share of the pixels that count as uncertain
    least: float = 0.01  # smaller changes never count
    first: float = 0.08  # noise ratio at the beginning
    last: float = 0.02  # noise ratio at the end

    def __post_init__(self) -> None:
        self.check("every", 0 < self.every <= 1, "a share in (0, 1]")
        self.check("cameras", 1 <= self.cameras <= 100, "an integer in [1, 100]")
        self.check("uncertain", 0 < self.uncertain <= 1, "a share in (0, 1]")
        self.check("least", self.least >= 0, "a number >= 0")
        self.check("first", 0 <= self.first <= 10, "a number in [0, 10]")
        self.check("last", 0 < self.last <= 10, "a number in (0, 10]")

    def init_state(self, ctx: StepContext) -> Watched:
        size, rng = ctx.views[0].camera.scaled(4), ctx.rng("cameras")
        return Watched(tuple(unseen_camera(ctx, rng, size) for _ in range(self.cameras)))

    def check_state(
        self, state: Any, gaussians: Gaussians, version: int, views: tuple[View, ...]
    ) -> None:
        from framework.shapes import check_camera, check_kind, check_tensor

        check_kind(self.name, state, Watched)
        check_kind(self.name, state.cameras, tuple)
        check_kind(self.name, state.looks, tuple)
        for camera in state.cameras:
            check_camera(self.name, camera)
        for looks, camera in zip(state.looks, state.cameras, strict=bool(state.looks)):
            check_tensor(self.name, looks, None, 3, camera.height, camera.width)

    def update(
        self, ctx: StepContext, state: Watched, stats: StepStats
    ) -> tuple[Edits | None, Any]:
        import torch

        if not ctx.second or ctx.other is None or not ctx.due(self.every):
            return None, state
        looks = []
        for camera, before in zip(
            state.cameras, state.looks or (None,) * self.cameras, strict=True
        ):
            new = ctx.render(camera, ctx.other).rgb[None].detach()
            looks.append(new if before is None else torch.cat([before, new])[-LOOKS:].contiguous())
        state = Watched(state.cameras, tuple(looks))
        if len(looks[0]) < LOOKS:
            return None, state
        chosen = in_uncertain_pixels(ctx.gaussians.means, state, self.uncertain, self.least)
        ratio = self.first * (self.last / max(self.first, 1e-12)) ** ctx.progress
        ctx.log(f"{self.name}_shaken", float(chosen.float().mean()))
        rng, values = ctx.rng("noise"), {}
        for name in SHAKEN:
            old = getattr(ctx.gaussians, name)
            noise = torch.from_numpy(rng.standard_normal(tuple(old.shape))).float()
            size = ratio * (ctx.extent if name == "means" else float(old.abs().mean()))
            values[name] = old + noise * size * chosen.view(-1, *[1] * (old.dim() - 1))
        return Edits(values=values), state


def in_uncertain_pixels(means: Tensor, watched: Watched, share: float, floor: float) -> Tensor:
    """[N] bool: whose centre is, for any of the cameras, in one of the `share` of its pixels whose
    last renders differ most, and by more than `floor`."""
    import torch
    from torch.nn.functional import avg_pool2d

    from framework.geometry import project

    chosen = torch.zeros(len(means), dtype=torch.bool)
    for camera, looks in zip(watched.cameras, watched.looks, strict=True):
        spread = looks.std(0).mean(0)[None, None]
        spread = avg_pool2d(spread, BOX, 1, BOX // 2, count_include_pad=False)[0, 0]
        least = torch.quantile(spread, 1 - share)
        pixels, depth = project(means.double(), camera)
        size = torch.tensor([camera.width, camera.height])
        places = pixels.floor().clamp(-1, 1e6).long()
        inside = (depth > 0) & ((places >= 0) & (places < size)).all(1)
        x, y = places[inside].unbind(1)
        there = chosen[inside] | (spread[y, x] >= least.clamp(min=max(floor, 1e-12)))
        chosen[inside] = there
    return chosen
