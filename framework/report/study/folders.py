"""The folders of runs below that of a study, whatever else lies there."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterator
from pathlib import Path

from framework.errors import UserError, os_line
from framework.records import RUN_FOLDERS
from framework.records.failure import FAILED
from framework.records.record import RECORD

DEPTH = 12  # folders between a study and its runs; links are not followed


def walked(folder: Path) -> Iterator[tuple[Path, set[str]]]:
    """`folder` and the folders below it, each with the names in it."""
    waiting = [(folder, 0)]
    while waiting:
        here, depth = waiting.pop()
        names, below = _listed(here)
        yield here, names
        if depth < DEPTH:
            waiting += [(here / name, depth + 1) for name in below]


def run_dirs(folder: Path) -> list[Path]:
    """Those with a record, or with what a failed run left, sorted."""
    return sorted(here for here, names in walked(folder) if holds_run(names))


def holds_run(names: Collection[str]) -> bool:
    """Whether a folder with these names in it is that of a run."""
    return RECORD in names or FAILED in names


def begun_dirs(folder: Path) -> list[Path]:
    """The folders of a study's runs in which there is neither: of a run that was killed before its
    end, or is still going. Sorted."""
    _, names = _listed(folder / RUN_FOLDERS)
    begun = (folder / RUN_FOLDERS / name for name in sorted(names) if not name.startswith("."))
    return [path for path in begun if not run_dirs(path)]


def _listed(folder: Path) -> tuple[set[str], list[str]]:
    """Return all names, and those of folders; nothing where it cannot be read, or is none.

    Raises UserError for runs that cannot be read, of which a report must not be silent.
    """
    try:
        with os.scandir(folder) as entries:
            kinds = {entry.name: entry.is_dir(follow_symlinks=False) for entry in entries}
    except OSError as error:
        if isinstance(error, PermissionError) and RUN_FOLDERS in (folder.name, folder.parent.name):
            raise UserError(os_line(error, folder)) from error
        return set(), []
    return set(kinds), [name for name, is_folder in kinds.items() if is_folder]
