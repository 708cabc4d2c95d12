"""The folder of generated files: `$FISHERSPLAT_CACHE`, else in the user's cache folder."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from framework.errors import FULL, UserError


def cache_dir() -> Path:
    """The cache folder, made if missing."""
    base = os.environ.get("FISHERSPLAT_CACHE")
    if base:  # also works for users without a home
        path = Path(base)
    else:
        path = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "fishersplat"
    with usable(path):
        path.mkdir(parents=True, exist_ok=True)
    return path


@contextmanager
def usable(path: Path) -> Iterator[None]:
    """Raise UserError for a cache folder that cannot be made or written."""
    try:
        yield
    except OSError as error:
        if error.errno in FULL:
            raise
        raise UserError(
            f"{path}: cannot write the cache folder ({error.strerror}); set FISHERSPLAT_CACHE to a"
            " folder that you may write"
        ) from error
