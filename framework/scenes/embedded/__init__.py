"""The embedded scene: procedural, ray-traced, exact. It needs no download and has no unknowns.

A room corner from 2 m to 8 m: photographs bundled with scikit-image, boxes, a mirror ball, a glazed
vase, a plant, a thin lattice, wires, a plain cupboard. Generated once per set of options, cached,
with the same bits on every machine. Poses, intrinsics and depth are exact.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import TYPE_CHECKING

from framework.errors import check_option
from framework.scenes.options import check_n_views

if TYPE_CHECKING:
    from framework.types import Scene


@dataclass(frozen=True)
class Embedded:
    """A ray-traced room in the repository itself, with exact depth.

    The training cameras stand in a zigzag of their own (protocol `rig`); eight test cameras, tagged
    `interpolating` (inside the training cameras' hull) or `extrapolating`, are always the same.
    """

    n_views: int = 3  # training views
    width: int = 320  # pixels
    height: int = 240  # pixels
    supersampling: int = 3  # rays per pixel along each axis
    spread: float = 0.35  # metres from the middle of the rig to its outer cameras
    texture: float = 1.0  # factor of all texture contrasts; 0 = textureless
    gloss: float = 1.0  # factor of all highlights and mirrors; 0 = matte
    pose_noise: float = 0.0  # pixels by which the training cameras' poses are wrong

    def __post_init__(self) -> None:
        check = functools.partial(check_option, self, "scene")
        check_n_views("embedded", self.n_views)
        check("n_views", self.n_views <= 64, "at most 64")
        check("width", 32 <= self.width <= 2048, "32 to 2048 pixels")
        check("height", 32 <= self.height <= 2048, "32 to 2048 pixels")
        check("supersampling", 1 <= self.supersampling <= 6, "1 to 6")
        check("spread", 0 < self.spread <= 1, "a number in (0, 1], metres")
        check("texture", 0 <= self.texture <= 2, "a number in [0, 2]")
        check("gloss", 0 <= self.gloss <= 1.3, "a number in [0, 1.3]")
        check("pose_noise", 0 <= self.pose_noise <= 20, "0 to 20 pixels")

    def load(self) -> Scene:
        """The scene, from the cache or generated (a few seconds, once)."""
        from framework.scenes.embedded.generate import load

        return load(self)
