"""A second camera beside a photo's: where its render, moved back by the depth, must be the photo.

With few photos colours may be right at any depth. A camera beside the photo, whose own photo is not
needed, tells: seen from there, Gaussians at a wrong depth are in the wrong place. The loss is
Binocular-Guided 3DGS's (`framework.kernels.binocular`), counted where both renders show the same
surface. `benchmarks/results/presets.md` has what chose the numbers.
"""

from __future__ import annotations

from dataclasses import dataclass

from framework.compute.rng import stream
from framework.geometry import moved_aside
from framework.types import Camera, View

SHIFT = 0.4  # largest move of the camera, in mean distances to the next training camera
AGREE = 2.0  # pixels of disparity, from one training camera to the next, by which depths may differ


@dataclass(frozen=True)
class Beside:
    """The camera beside a view, and what the loss needs. moves: f t, pixels x scene units.
    tolerance: of inverse depth. weight: of a pixel and channel."""

    camera: Camera
    moves: float
    tolerance: float
    weight: float


@dataclass(frozen=True)
class Binocular:
    """weight: of the mean over pixels and channels. spacing: mean distance of neighbouring training
    cameras, in scene units. since: the first step. seed: of the draws."""

    weight: float
    spacing: float
    since: int
    seed: int

    def beside(self, view: View, step: int) -> Beside | None:
        """The camera beside `view` in this step; None before `since`."""
        if step < self.since:
            return None
        draw = float(stream(self.seed, "binocular", step).uniform(-1, 1))
        shift = SHIFT * self.spacing * draw
        focal = float(view.camera.K[0, 0])
        weight = self.weight * view.weight / view.image.numel()
        tolerance = AGREE / (focal * self.spacing)
        return Beside(moved_aside(view.camera, shift), focal * shift, tolerance, weight)
