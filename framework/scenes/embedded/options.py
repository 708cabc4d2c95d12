"""The options of the embedded scene, below what generates it. Light to import."""

import functools
from dataclasses import dataclass

from framework.errors import check_option
from framework.scenes.layout import check_n_views


@dataclass(frozen=True)
class EmbeddedOptions:
    """Options of `scene=embedded`."""

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
