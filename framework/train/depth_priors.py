"""Priors on depth: smoothness, and agreement with a second camera.

Smoothness penalises steps of the disparity where the photo is smooth (Godard et al. 2017, eq. 3).
With few photos, half of a test view may be visible in a single photo or have no texture. There,
Gaussians at any depth can reproduce the photo. The prior also holds outside a mask's pixels, where
surfaces continue.

The second camera (Binocular-Guided 3DGS, Han et al. 2024) needs no photo. Its render is warped back
by the depth, so Gaussians at a wrong depth end up in the wrong place. It counts where both renders
show the same surface. docs/decisions.md explains how the constants were chosen.
"""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from framework.compute.portable import exp
from framework.compute.rng import stream
from framework.geometry import moved_aside
from framework.types import Camera, View

EDGE = 10.0  # how fast smoothness fades with a step of the photo, whose values are in [0, 1]
SHIFT = 0.4  # largest move of the camera, in mean distances to the next training camera
AGREE = 2.0  # largest difference of disparities between neighbouring cameras, in pixels


@dataclass(frozen=True)
class DepthSmoothness:
    """Smoothness of the disparity of real views.

    Attributes:
        weight: of the mean over pixels of the disparity's steps.
        spacing: mean distance of neighbouring training cameras. Disparity is the motion of a point
            between them, in pixels.
    """

    weight: float
    spacing: float

    def weights(self, view: View) -> Tensor:
        """Return the smoothness weights [2, H, W] float32 for steps of inverse depth to the right
        and lower neighbour. They are exp(-10 mean |step of the photo|), and 0 across the image
        border.
        """
        photo = view.image.numpy().astype(np.float64)
        weights = np.zeros((2, *photo.shape[1:]))
        for i, axis in enumerate((2, 1)):
            red, green, blue = np.abs(np.diff(photo, axis=axis))
            fading = exp(-EDGE / 3 * (red + green + blue))
            weights[i][tuple(map(slice, fading.shape))] = fading
        pixels = photo.shape[1] * photo.shape[2]
        per_step = self.weight * view.weight * self.spacing * float(view.camera.K[0, 0]) / pixels
        return torch.from_numpy((per_step * weights).astype(np.float32))


@dataclass(frozen=True)
class Beside:
    """A second camera beside a view.

    Attributes:
        moves: f t, in pixels x scene units.
        tolerance: of inverse depth.
        weight: of a pixel and channel.
    """

    camera: Camera
    moves: float
    tolerance: float
    weight: float


@dataclass(frozen=True)
class Binocular:
    """Draws the second camera of each step.

    Attributes:
        weight: of the mean over pixels and channels.
        spacing: mean distance of neighbouring training cameras, in scene units.
        since: the first step.
        seed: of the draws.
    """

    weight: float
    spacing: float
    since: int
    seed: int

    def beside(self, view: View, step: int) -> Beside | None:
        """Return the camera beside `view` in this step; None before `since`."""
        if step < self.since:
            return None
        draw = float(stream(self.seed, "binocular", step).uniform(-1, 1))
        shift = SHIFT * self.spacing * draw
        focal = float(view.camera.K[0, 0])
        weight = self.weight * view.weight / view.image.numel()
        tolerance = AGREE / (focal * self.spacing)
        return Beside(moved_aside(view.camera, shift), focal * shift, tolerance, weight)
