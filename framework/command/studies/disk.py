"""How much room the results of a study take, estimated before its first run; bytes throughout.

A run keeps its Gaussians (17 + 3 (K - 1) floats each), three 8-bit images per test view, which PNG
at worst does not compress, and tables. While it trains there are up to three checkpoints of about
twice the parameters with their two moments each, and two of every member that has ended.
"""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from framework.errors import require
from framework.initialize.stereo import LARGEST_BUDGET
from framework.options import MOST_STEPS, members_of
from framework.records import RUN_FOLDERS

TABLES = 200_000
TEST_VIEWS = 8  # of the embedded scene
PHOTO_RENDERS = 50_000_000  # of a scene of photos, whose sizes are known only once it is read


def run_bytes(config: Mapping[str, Any]) -> int:
    """What the folder of a complete run takes, about and rather too much."""
    scene = config["scene"]
    embedded = "width" in scene and "height" in scene
    renders = 9 * TEST_VIEWS * scene["width"] * scene["height"] if embedded else PHOTO_RENDERS
    return _parameter_bytes(config, 17) + renders + TABLES


def checkpoint_bytes(config: Mapping[str, Any]) -> int:
    """What the checkpoints of one run take while it trains."""
    several = _most_members(config["trainer"]) > 1
    return (5 if several else 3) * 2 * 3 * _parameter_bytes(config, 14)


def _parameter_bytes(config: Mapping[str, Any], floats: int) -> int:
    trainer = config["trainer"]
    gaussians = _most_members(trainer) * (config["init"].get("budget") or LARGEST_BUDGET)
    harmonics = 3 * ((trainer["sh_degree"] + 1) ** 2 - 1)
    return 4 * gaussians * (floats + harmonics)


def _most_members(trainer: Mapping[str, Any]) -> int:
    """How many trainings are joined; at most, where the views decide."""
    steps = MOST_STEPS if trainer.get("seconds") else trainer["steps"]
    return members_of(trainer["members"], steps, n_views=1)


def check_room(folder: Path, configs: Sequence[Mapping[str, Any]]) -> None:
    """Raise UserError unless the disk of `folder` has room for runs of these configurations; what
    is there already, of an earlier attempt, counts as theirs."""
    there = _size(folder)
    wanted = sum(run_bytes(config) for config in configs) - there
    needed = max(0, wanted) + max(checkpoint_bytes(config) for config in configs)
    existing = next(path for path in (folder, *folder.absolute().parents) if path.exists())
    free = shutil.disk_usage(existing).free
    require(
        free >= needed,
        f"{folder}: expected about {_text(needed)} free for {len(configs)} runs, got {_text(free)};"
        " free some space or set hydra.sweep.dir to a folder on another disk",
    )


def check_links(folder: Path) -> None:
    """Raise UserError for a link below the folder of a study or a run, where a run writes: through
    it, something elsewhere would be overwritten. What lies beside a study's `runs`, and where
    `runs` itself leads, is the user's."""
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


def _size(folder: Path) -> int:
    """Bytes of all files below; another process may be at work there, what vanishes counts 0."""
    total = 0
    for parent, _, names in os.walk(folder):
        for name in names:
            with contextlib.suppress(FileNotFoundError):
                total += os.lstat(os.path.join(parent, name)).st_size
    return total


def _text(n_bytes: int) -> str:
    return f"{n_bytes / 1e9:.1f} GB" if n_bytes >= 1e9 else f"{n_bytes / 1e6:.0f} MB"
