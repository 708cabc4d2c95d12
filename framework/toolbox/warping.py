"""Common part of augmenters that warp training views into a new camera by their depth.

A subclass chooses the support views (`select`) and may choose the camera (`sample_camera`).
Warping, the coverage rule and the pseudo view are shared, so methods differ in these choices only.
Light to import: torch and numba are loaded when the first camera is sampled.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

from framework.errors import UserError
from framework.plugin import Augmenter, StepContext

if TYPE_CHECKING:
    import numpy as np

    from framework.types import Camera, Gaussians, View


@dataclass(frozen=True)
class WarpingState:
    """State of a warping augmenter between epochs.

    Attributes:
        selection: state of `select`.
        view: the current pseudo view, None if the last one covered too little.
        made: the epoch in which it was made, -1 before the first.
    """

    selection: Any = None
    view: View | None = None
    made: int = -1


@dataclass(frozen=True)
class WarpingAugmenter(Augmenter):
    """One pseudo view at a new camera, warped from the training views that `select` returns.

    Attributes:
        every: epochs that a pseudo view lives (a new one costs about as much as two training
            steps).
        sigma_center: the paper's sigma_C, jitter of the centre per axis, in mean distances to the
            next camera. With a single training camera the unit is the extent.
        sigma_rotation: the paper's sigma_theta, jitter of the orientation in degrees, about a
            random axis.
        roll: whether that may turn the image in its plane. Without it the axis is one across the
            viewing direction.
        temperature: softness of the z-buffer as a share of depth.
        min_coverage: least area of a pseudo view, as a share of what confident depth covers. The
            reference is the mean over the training views; a view that covers less is not used. The
            framework key `start` sets the warm-up.
    """

    every: int = 2
    sigma_center: float = 0.3
    sigma_rotation: float = 2.0
    roll: bool = True
    temperature: float = 0.02
    min_coverage: float = 0.3

    # chosen as for reg=uar: a warped image is softer than a photo and must not dominate it
    defaults: ClassVar[dict[str, float]] = {"start": 0.1, "stop": 0.8, "weight": 0.3}

    def __post_init__(self) -> None:
        self.check("every", self.every >= 1, "an integer >= 1")
        self.check("sigma_center", 0 <= self.sigma_center <= 10, "a number in [0, 10]")
        self.check("sigma_rotation", 0 <= self.sigma_rotation <= 90, "degrees in [0, 90]")
        self.check("temperature", 0 < self.temperature <= 1, "a number in (0, 1]")
        self.check("min_coverage", 0 <= self.min_coverage <= 1, "a share in [0, 1]")

    def sample_camera(self, ctx: StepContext) -> Camera:
        """Choose the camera of the next pseudo view; override it for another choice.

        By default a random training camera, perturbed by `sigma_center` and `sigma_rotation`. The
        draws come from `ctx.rng("camera")`, so all methods are compared on the same cameras.

        Args:
            ctx: the training at the start of an epoch; `ctx.views` have the training cameras.

        Returns:
            Any camera of the scene. Its size is the size of the pseudo view.
        """
        rng = ctx.rng("camera")
        cameras = [view.camera for view in ctx.views]
        start = cameras[int(rng.integers(len(cameras)))]
        sigma_center = self.sigma_center * ctx.spacing
        return perturbed(start, rng, sigma_center, self.sigma_rotation, roll=self.roll)

    def select(self, ctx: StepContext, selection: Any, camera: Camera) -> tuple[list[int], Any]:
        """Choose the support views of `camera`.

        Args:
            ctx: the training at the start of an epoch.
            selection: what the last call returned as its state, None at first.
            camera: the camera of the pseudo view.

        Returns:
            Indices into `ctx.views` of the views to warp, and the state for the next call.
        """
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
        """Raise ValueError unless `select` can continue with `selection`, see `check_state`."""

    def pseudo_views(
        self, ctx: StepContext, state: WarpingState | None
    ) -> tuple[list[View], WarpingState]:
        state = state or WarpingState()
        if state.view is None or ctx.epoch >= state.made + self.every:
            state = self._renewed(ctx, state)
        return [] if state.view is None else [state.view], state

    def _renewed(self, ctx: StepContext, state: WarpingState) -> WarpingState:
        """The state with this epoch's pseudo view."""
        from framework.types import Camera, View
        from framework.warp.zbuffer import warp

        camera = self.sample_camera(ctx)
        if not isinstance(camera, Camera):
            raise UserError(
                f"augment={self.name}: expected sample_camera to return a Camera, got"
                f" {type(camera).__name__}; fix the plugin"
            )
        chosen, selection = self.select(ctx, state.selection, camera)
        supports = ctx.supports()
        warped = warp([supports[i] for i in chosen], camera, temperature=self.temperature)
        # relative to the frame, a scene whose depth covers half of it would have no pseudo view
        possible = sum(support.known for support in supports) / len(supports)
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
        """Log their number, mean distance in camera spacings, whether the nearest photo is among
        them, and their mean rank by distance (1 = nearest)."""
        distances = center_distances(ctx.views, camera)
        ctx.log(f"{self.name}_supports", len(chosen))
        if chosen:
            mean = sum(distances[i] for i in chosen) / len(chosen)
            ranks = [1 + sum(d < distances[i] for d in distances) for i in chosen]
            ctx.log(f"{self.name}_support_distance", mean / ctx.spacing)
            ctx.log(f"{self.name}_nearest", float(1 in ranks))
            ctx.log(f"{self.name}_support_rank", sum(ranks) / len(ranks))


@dataclass(frozen=True)
class ThresholdAugmenter(WarpingAugmenter):
    """A warping method that scores the training views and warps all whose score is near the best.

    Attributes:
        eta: a view supports if its score is at most eta (the paper's symbol) x the smallest.
    """

    eta: float = 1.5

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check("eta", 1 <= self.eta <= 1e6, "a number in [1, 1e6]")

    def scores(self, ctx: StepContext, selection: Any, camera: Camera) -> tuple[list[float], Any]:
        """Score every training view, smaller = closer to `camera`.

        Returns:
            One number >= 0 per training view, and the state for the next call.
        """
        raise NotImplementedError

    def select(self, ctx: StepContext, selection: Any, camera: Camera) -> tuple[list[int], Any]:
        scores, selection = self.scores(ctx, selection, camera)
        return within(scores, self.eta), selection


def within(scores: Sequence[float], eta: float) -> list[int]:
    """Return the indices of the scores (>= 0) of at most eta x the smallest, in order."""
    return [i for i, score in enumerate(scores) if score <= eta * min(scores)]


def center_distances(views: Sequence[View], camera: Camera) -> list[float]:
    """Return the distance of each view's camera centre to that of `camera`, in scene units."""
    from framework.geometry import distance

    return [distance(view.camera, camera) for view in views]


def perturbed(
    camera: Camera,
    rng: np.random.Generator,
    sigma_center: float,
    sigma_degrees: float,
    roll: bool = True,
) -> Camera:
    """Move and turn a camera at random; intrinsics and size stay.

    Always draws the same count of numbers, so a standard deviation of 0 shifts no other draw.

    Args:
        sigma_center: standard deviation of the move per axis, in scene units.
        sigma_degrees: standard deviation of the turn, in degrees.
        roll: whether its axis may be the viewing direction.
    """
    import torch

    from framework import geometry

    step, axis, angle = rng.standard_normal(3), rng.standard_normal(3), rng.standard_normal()
    if not roll:
        axis[2] = 0.0  # the camera's viewing direction
    length = math.sqrt(sum(float(value) ** 2 for value in axis))
    turn = math.radians(sigma_degrees) * float(angle) / length * torch.from_numpy(axis)
    return geometry.perturbed(camera, turn, sigma_center * torch.from_numpy(step))
