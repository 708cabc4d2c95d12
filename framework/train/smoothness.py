"""Depth that is smooth where its photo is: what ties surfaces down that no other photo confirms.

With few photos half of what a test view shows may be seen by one photo alone, or be without
texture; Gaussians hang there at any depth that gives the photo its colours. The prior is as old as
stereo, here as Godard et al. 2017 have it (eq. 3). It holds where a mask says that colours do not
count, too: a surface goes on there (`benchmarks/results/presets.md` has what that is worth).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from framework.compute.portable import exp
from framework.types import View

EDGE = 10.0  # how fast it fades with a step of the photo, whose values are in [0, 1]


@dataclass(frozen=True)
class DepthSmoothness:
    """weight: of the mean over pixels of the disparity's steps to the right and lower neighbours.
    spacing: distance of neighbouring training cameras in scene units: disparity is what a point
    moves in pixels from one to the next, so it means the same at any scale, size and distance."""

    weight: float
    spacing: float

    def weights(self, view: View) -> Tensor:
        """[2, H, W] float32, towards the right and the lower neighbour, of the steps of a render's
        inverse depth: exp(-10 mean |step of the photo|); 0 over the frame's edge."""
        photo = view.image.numpy().astype(np.float64)
        weights = np.zeros((2, *photo.shape[1:]))
        for i, axis in enumerate((2, 1)):
            red, green, blue = np.abs(np.diff(photo, axis=axis))
            fading = exp(-EDGE / 3 * (red + green + blue))
            weights[i][tuple(map(slice, fading.shape))] = fading
        pixels = photo.shape[1] * photo.shape[2]
        per_step = self.weight * view.weight * self.spacing * float(view.camera.K[0, 0]) / pixels
        return torch.from_numpy((per_step * weights).astype(np.float32))
