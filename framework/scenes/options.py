"""Checks that several loaders' options share."""

from __future__ import annotations

import math

from framework.errors import require
from framework.scenes.splits import ALL, protocol

# axes of the camera, and whether a matrix is camera-to-world or its inverse: see `conventions`
CONVENTIONS = ("opencv_c2w", "opencv_w2c", "opengl_c2w", "opengl_w2c", "llff_c2w", "llff_w2c")


def check_n_views(loader: str, n_views: int | str, all_too: bool = False) -> None:
    """A positive integer; `all` too where a folder has a number of photos."""
    whole = isinstance(n_views, int) and not isinstance(n_views, bool) and n_views >= 1
    require(
        whole or (all_too and n_views == ALL),
        f"scene={loader}: expected n_views to be an integer >= 1{f' or {ALL}' if all_too else ''},"
        f" got {n_views}; set scene.n_views",
    )


def check_folder_options(
    loader: str, path: str, n_views: int | str, split: str, downscale: int = 1
) -> None:
    """What every loader of a folder takes: its path, the number of views, the split protocol and
    by how much the photos are reduced."""
    require(
        isinstance(path, str) and path != "",
        f"scene={loader}: expected the scene's folder, got '{path}'; give scene.path=DIR",
    )
    check_n_views(loader, n_views, all_too=True)
    whole = isinstance(downscale, int) and not isinstance(downscale, bool)
    require(
        whole and downscale >= 1,
        f"scene={loader}: expected downscale to be an integer >= 1, got {downscale};"
        " 1 keeps the photos' size",
    )
    protocol(split)


def check_images(loader: str, images: str, model: str = "auto") -> None:
    """Names of folders inside the scene's: of the photos, and of the COLMAP model."""
    for option, what, name in (("images", "photos", images), ("model", "COLMAP model", model)):
        require(
            isinstance(name, str) and name != "",
            f"scene={loader}: expected the folder of the {what}, got '{name}'; set scene.{option}",
        )


def check_range(loader: str, near: float | None, far: float | None) -> None:
    """Depth bounds, of which either may be None."""
    given = [bound for bound in (near, far) if bound is not None]
    require(
        all(0 < bound < math.inf for bound in given) and given == sorted(set(given)),
        f"scene={loader}: expected 0 < near < far, got near={near}, far={far}; correct scene.near"
        " and scene.far",
    )


def check_choice(loader: str, option: str, value: str, choices: tuple[str, ...]) -> None:
    """One of a few words."""
    require(
        value in choices,
        f"scene={loader}: expected {option} to be one of {', '.join(choices)}, got '{value}';"
        f" set scene.{option}",
    )
