"""`--plugins DIR`: the user's own plugins, found only because the command line asks for them.

A plugin is code, so no configuration may name its folder. The processes that do the runs know it by
an environment variable.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from framework.errors import UserError, require
from framework.files.paths import OWN_VARIABLE

FLAG = "--plugins"


def take_flag(argv: Sequence[str]) -> list[str]:
    """`argv` without `--plugins DIR`, whose folder is searched from now on; without one, none is.

    Raises UserError where DIR is missing, no folder, or named twice.
    """
    rest, folders, words = [], [], iter(argv)
    for word in words:
        if word == FLAG:
            folders.append(next(words, ""))
        elif word.startswith(f"{FLAG}="):
            folders.append(word.partition("=")[2])
        else:
            rest.append(word)
    os.environ.pop(OWN_VARIABLE, None)
    if folders:
        require(len(folders) == 1, f"{FLAG}: expected it once, got it {len(folders)} times")
        os.environ[OWN_VARIABLE] = str(_folder(folders[0]))
    return rest


def asked(argv: Sequence[str]) -> bool:
    """Whether the flag is on the line."""
    return any(word.partition("=")[0] == FLAG for word in argv)


def flags() -> list[str]:
    """The words that ask for the same folder again."""
    folder = os.environ.get(OWN_VARIABLE)
    return [] if folder is None else [FLAG, folder]


def _folder(given: str) -> Path:
    folder = Path(given).resolve()
    if not given or "=" in given or not folder.is_dir():
        raise UserError(
            f"{FLAG}: expected a folder with plugins (.py files), got {given or 'nothing'!r}; write"
            f" {FLAG} DIR, for instance {FLAG} plugins"
        )
    return folder
