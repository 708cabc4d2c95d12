"""`rasterizer=reference`: plain torch on the CPU, by autograd; for small scenes and checks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from framework.backends.autograd import ByAutograd
from framework.errors import UserError

if TYPE_CHECKING:
    from framework.types import Camera, Gaussians, Render

MOST_PAIRS = 10**8  # of a Gaussian and a pixel; all are in memory at once, about 100 bytes each


@dataclass(frozen=True)
class Reference(ByAutograd):
    """`framework.kernels.reference`, the definition that the kernels are tested against."""

    name: ClassVar[str] = "reference"

    def render(
        self, gaussians: Gaussians, camera: Camera, *, depth: bool = True, **how: Any
    ) -> Render:
        from framework.kernels.reference import rasterize_reference

        pairs = len(gaussians) * camera.width * camera.height
        if pairs > MOST_PAIRS:
            raise UserError(
                f"rasterizer=reference: expected Gaussians x pixels of at most {MOST_PAIRS:.0e},"
                f" got {len(gaussians)} x {camera.width * camera.height}; it holds every pair in"
                " memory: lower init.budget or the size of the images, or use rasterizer=numba"
            )
        return rasterize_reference(gaussians, camera, **how)
