"""Checks that several loaders' options share."""

from __future__ import annotations

from framework.errors import require
from framework.scenes.splits import protocol


def check_n_views(loader: str, n_views: int) -> None:
    """A positive integer."""
    whole = isinstance(n_views, int) and not isinstance(n_views, bool)
    require(
        whole and n_views >= 1,
        f"scene={loader}: expected n_views of at least 1, got {n_views}; raise scene.n_views",
    )


def check_folder_options(loader: str, path: str, n_views: int, split: str) -> None:
    """What every loader of a folder takes: its path, the number of views, the split protocol."""
    require(
        isinstance(path, str) and path != "",
        f"scene={loader}: expected the scene's folder, got '{path}'; give scene.path=DIR",
    )
    check_n_views(loader, n_views)
    protocol(split)
