"""The common part of augmenters that warp training views into perturbed cameras.

Such a method is a subclass with a `select`: which training views support a new camera. Sampling the
camera, warping, the coverage rule and the pseudo view are here, so that methods differ in nothing
but their choice of supports. Light to import: torch and numba come in when a camera is sampled.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

from framework.plugin import Augmenter, StepContext

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np

    from framework.types import Camera, Gaussians, View
    from framework.warp.zbuffer import Support


@dataclass(frozen=True)
class WarpingState:
    """selection: what `select` keeps between epochs. view: the current pseudo view, None if the
    last one covered too little. made: the epoch in which it was made, -1 before the first."""

    selection: Any = None
    view: View | None = None
    made: int = -1


@dataclass(frozen=True)
class WarpingAugmenter(Augmenter):
    """One pseudo view at a perturbed training camera, warped from the views `select` chooses.

    every: epochs that a pseudo view lives (a new one costs about as much as two training steps).
    sigma_center: the paper's sigma_C, jitter of the centre per axis, in mean distances to the next
    camera. Those are of the training cameras (extents for a single one). sigma_rotation: the
    paper's sigma_theta, jitter of the orientation in degrees, about a random axis. roll: whether
    that may turn the image in its plane. Without it the axis is one across the viewing direction.
    temperature: softness of the z-buffer as a share of depth. min_coverage: least area of a pseudo
    view, as a share of what confident depth covers. That is the mean area over the training views;
    a view that covers less is not used. The warm-up is the framework key `start`.
    """

    every: int = 2
    sigma_center: float = 0.3
    sigma_rotation: float = 2.0
    roll: bool = True
    temperature: float = 0.02
    min_coverage: float = 0.3

    # chosen like those of reg=uar: a warped image is softer than a photo and must not outvote it
    defaults: ClassVar[dict[str, float]] = {"start": 0.1, "stop": 0.8, "weight": 0.3}

    def __post_init__(self) -> None:
        self.check("every", self.every >= 1, "an integer >= 1")
        self.check("sigma_center", 0 <= self.sigma_center <= 10, "a number in [0, 10]")
        self.check("sigma_rotation", 0 <= self.sigma_rotation <= 90, "degrees in [0, 90]")
        self.check("temperature", 0 < self.temperature <= 1, "a number in (0, 1]")
        self.check("min_coverage", 0 <= self.min_coverage <= 1, "a share in [0, 1]")

    def select(self, ctx: StepContext, selection: Any, camera: Camera) -> tuple[list[int], Any]:
        """Indices of the training views to warp into `camera`, and the next `selection`."""
        raise NotImplementedError

    def check_state(
        self, state: Any, gaussians: Gaussians, version: int, views: tuple[View, ...]
    ) -> None:
        from framework.shapes import check_kind, check_view

        check_kind(self.name, state, WarpingState, type(None))
        if state is None:
            return
        if state.view is not None:
            check_view(f"{self.name}.view", state.view)
        check_kind(f"{self.name}.made", state.made, int)
        self.check_selection(state.selection, gaussians, views)

    def check_selection(
        self, selection: Any, gaussians: Gaussians, views: tuple[View, ...]
    ) -> None:
        """Raise ValueError unless `select` can go on with `selection`, see `check_state`."""

    def pseudo_views(
        self, ctx: StepContext, state: WarpingState | None
    ) -> tuple[list[View], WarpingState]:
        state = state or WarpingState()
        if state.view is None or ctx.epoch >= state.made + self.every:
            state = self._renewed(ctx, state)
        return [] if state.view is None else [state.view], state

    def _renewed(self, ctx: StepContext, state: WarpingState) -> WarpingState:
        """The state with this epoch's pseudo view."""
        from framework.types import View
        from framework.warp.zbuffer import warp

        camera = self._sample_camera(ctx)
        chosen, selection = self.select(ctx, state.selection, camera)
        supports = ctx.supports()
        warped = warp([supports[i] for i in chosen], camera, temperature=self.temperature)
        # against the frame, a scene whose depth covers half of it would have no pseudo view at all
        possible = known_share(supports)
        covered = warped.coverage / possible if possible > 0 else 0.0
        self._log_supports(ctx, chosen, camera)
        ctx.log(f"{self.name}_coverage", warped.coverage)
        ctx.log(f"{self.name}_coverage_of_depth", covered)
        view = None
        if covered >= self.min_coverage:
            view = View(f"pseudo-{ctx.epoch}", camera, warped.image, mask=warped.mask)
        else:
            ctx.log(f"{self.name}_refused_coverage", 1.0)
        return replace(state, selection=selection, view=view, made=ctx.epoch)

    def _log_supports(self, ctx: StepContext, chosen: Sequence[int], camera: Camera) -> None:
        """How many there are, how far from the camera, in camera spacings, whether the nearest
        photo is among them, and which they are on average by nearness (1: the nearest)."""
        distances = center_distances(ctx.views, camera)
        ctx.log(f"{self.name}_supports", len(chosen))
        if chosen:
            mean = sum(distances[i] for i in chosen) / len(chosen)
            ranks = [1 + sum(d < distances[i] for d in distances) for i in chosen]
            ctx.log(f"{self.name}_support_distance", mean / ctx.spacing)
            ctx.log(f"{self.name}_nearest", float(1 in ranks))
            ctx.log(f"{self.name}_support_rank", sum(ranks) / len(ranks))

    def _sample_camera(self, ctx: StepContext) -> Camera:
        rng = ctx.rng("camera")  # not by method: all compare on the same cameras
        cameras = [view.camera for view in ctx.views]
        start = cameras[int(rng.integers(len(cameras)))]
        sigma_center = self.sigma_center * ctx.spacing
        return perturbed(start, rng, sigma_center, self.sigma_rotation, roll=self.roll)


@dataclass(frozen=True)
class ThresholdAugmenter(WarpingAugmenter):
    """A warping method that scores the training views and warps all that come near the best.

    eta: a view supports if its score is at most eta (the paper's symbol) x the smallest.
    """

    eta: float = 1.5

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check("eta", 1 <= self.eta <= 1e6, "a number in [1, 1e6]")

    def scores(self, ctx: StepContext, selection: Any, camera: Camera) -> tuple[list[float], Any]:
        """One score >= 0 per training view, smaller = closer to `camera`; the next `selection`."""
        raise NotImplementedError

    def select(self, ctx: StepContext, selection: Any, camera: Camera) -> tuple[list[int], Any]:
        scores, selection = self.scores(ctx, selection, camera)
        return within(scores, self.eta), selection


def within(scores: Sequence[float], eta: float) -> list[int]:
    """Indices of the scores of at most eta x the smallest, in order; scores are >= 0."""
    return [i for i, score in enumerate(scores) if score <= eta * min(scores)]


def center_distances(views: Sequence[View], camera: Camera) -> list[float]:
    """Distance of each view's camera centre (not of its translation column, which also depends on
    the orientation) to that of `camera`, in scene units."""
    from framework.geometry import distance

    return [distance(view.camera, camera) for view in views]


def known_share(supports: Sequence[Support]) -> float:
    """The share of the frame that confident depth covers, mean over `supports`."""
    return sum(support.known for support in supports) / len(supports)


def perturbed(
    camera: Camera,
    rng: np.random.Generator,
    sigma_center: float,
    sigma_degrees: float,
    roll: bool = True,
) -> Camera:
    """`camera` with its centre moved by N(0, sigma_center^2) per axis (scene units) and turned by
    N(0, sigma_degrees^2) about an axis uniform on the sphere, or without `roll` on the circle
    across the viewing direction; same K and size.

    Always draws the same count of numbers, so that a standard deviation of 0 moves no other draw.
    """
    import torch

    from framework import geometry

    step, axis, angle = rng.standard_normal(3), rng.standard_normal(3), rng.standard_normal()
    if not roll:
        axis[2] = 0.0  # of the camera's own axes the viewing direction
    length = math.sqrt(sum(float(value) ** 2 for value in axis))
    turn = math.radians(sigma_degrees) * float(angle) / length * torch.from_numpy(axis)
    return geometry.perturbed(camera, turn, sigma_center * torch.from_numpy(step))
