"""A step context of the capacities that look at the images: the stage's views and true Fisher."""

from dataclasses import replace

import torch

from framework.fisher.information import FisherInformation, fisher_information
from framework.kernels import rasterize
from framework.plugin import StepContext, StepStats
from framework.types import Camera, Gaussians, Render
from tests.plugins.fakes import Log, context, wall_of_gaussians


def watched(
    subject: Gaussians | None = None, step: int = 49, log: Log | None = None
) -> StepContext:
    """In the middle of 100 steps on the stage, with `subject` rendered and informed on as is."""
    gaussians = wall_of_gaussians() if subject is None else subject

    def fisher(camera: Camera) -> FisherInformation:
        return fisher_information(gaussians, camera, background=torch.zeros(3))

    def render(camera: Camera) -> Render:
        return rasterize(gaussians, camera, background=torch.zeros(3))

    return replace(context(gaussians=gaussians, fisher=fisher, step=step, log=log), render=render)


def pulls(values: torch.Tensor) -> StepStats:
    """A step that saw every Gaussian and pulled it by `values` [N] in NDC."""
    gradient = torch.stack([values / 50, torch.zeros_like(values)], 1)
    return StepStats(gradient, torch.full_like(values, 3.0), width=100, height=100)
