"""Checks of options that several loaders share."""

from __future__ import annotations

import math
from typing import Any

from framework.errors import require
from framework.scenes.splits import ALL, FILES, protocol

AUTO = "auto"  # let the loader choose a folder
# axes of the camera, and whether a matrix is camera-to-world or its inverse: see `conventions`
CONVENTIONS = ("opencv_c2w", "opencv_w2c", "opengl_c2w", "opengl_w2c", "llff_c2w", "llff_w2c")


def check_n_views(loader: str, n_views: int | str, all_too: bool = False) -> None:
    """Check for a positive integer; `all_too` also allows `all`."""
    whole = isinstance(n_views, int) and not isinstance(n_views, bool) and n_views >= 1
    require(
        whole or (all_too and n_views == ALL),
        f"scene={loader}: expected n_views to be an integer >= 1{f' or {ALL}' if all_too else ''},"
        f" got {n_views}; set scene.n_views",
    )


def check_folder_options(loader: str, options: Any, files: bool = False) -> None:
    """Check the options that loaders of a folder share, as far as they exist.

    Args:
        loader: name of the loader.
        options: its options.
        files: whether the scene's files may define the split.

    Raises:
        UserError: an option is invalid.
    """
    require(
        isinstance(options.path, str) and options.path != "",
        f"scene={loader}: expected the scene's folder, got '{options.path}'; give scene.path=DIR",
    )
    check_n_views(loader, options.n_views, all_too=True)
    downscale = options.downscale
    whole = isinstance(downscale, int) and not isinstance(downscale, bool)
    least = 0 if loader == "photos" else 1
    require(
        (downscale is None and loader == "dtu") or (whole and downscale >= least),
        f"scene={loader}: expected downscale to be an integer >= 1, got {downscale};"
        " 1 keeps the photos' size",
    )
    if not (files and options.split in FILES):
        protocol(options.split)
    for option, what in (("images", "photos"), ("model", "COLMAP model")):
        name = getattr(options, option, AUTO)
        require(
            isinstance(name, str) and name != "",
            f"scene={loader}: expected the folder of the {what}, got '{name}'; set scene.{option}",
        )
    _check_range(loader, options.near, options.far)
    if hasattr(options, "poses"):
        check_choice(loader, "poses", options.poses, CONVENTIONS)


def _check_range(loader: str, near: float | None, far: float | None) -> None:
    """Check depth bounds, of which either may be None."""
    bounds = [bound for bound in (near, far) if bound is not None]
    require(
        all(0 < bound < math.inf for bound in bounds) and bounds == sorted(set(bounds)),
        f"scene={loader}: expected 0 < near < far, got near={near}, far={far}; correct scene.near"
        " and scene.far",
    )


def check_choice(loader: str, option: str, value: str, choices: tuple[str, ...]) -> None:
    """Check that a value is one of `choices`."""
    require(
        value in choices,
        f"scene={loader}: expected {option} to be one of {', '.join(choices)}, got '{value}';"
        f" set scene.{option}",
    )
