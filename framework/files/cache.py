"""Where generated things are kept: `$FISHERSPLAT_CACHE`, else in the user's cache folder."""

from __future__ import annotations

import os
from pathlib import Path


def cache_dir() -> Path:
    """The cache folder, made if missing."""
    base = os.environ.get("FISHERSPLAT_CACHE")
    if base:  # before the home is asked for, which not every user has
        path = Path(base)
    else:
        path = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "fishersplat"
    path.mkdir(parents=True, exist_ok=True)
    return path
