"""Quick checks, before the first run of a study, that this machine has what its runs need."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from framework import registry
from framework.backends import build_rasterizer
from framework.errors import require
from framework.records import RUN_FOLDERS

WITH_PATH = ("scene", "depth")  # groups whose option `path` names files of this machine


def check_ready(config: Mapping[str, Any]) -> None:
    """Raise UserError if a folder of a checked configuration is missing, or a part is not ready on
    this machine. Reads no files."""
    for group in WITH_PATH:
        path = config[group].get("path")
        require(
            not isinstance(path, str) or Path(path).expanduser().exists(),
            f"{group}={config[group]['name']}: expected a file or folder at '{path}', found"
            f" nothing; correct {group}.path",
        )
    registry.part("depth", config["depth"]).ready()
    build_rasterizer(config).ready()


def check_links(folder: Path) -> None:
    """Raise UserError for a link in a folder where runs write, which would overwrite other files.

    Args:
        folder: of a study, of which only `runs` is checked, or of a run.
    """
    runs = folder / RUN_FOLDERS
    top = runs if runs.is_dir() else folder
    for parent, folders, names in os.walk(top):
        for name in (*folders, *names):
            path = os.path.join(parent, name)
            require(
                not os.path.islink(path),
                f"{path}: expected no link where a run writes, got one; remove it and run the same"
                " again",
            )
