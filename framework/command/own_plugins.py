"""`--plugins DIR`: the user's own plugins, found only because the command line asks for them.

A plugin is code, so no configuration may name its folder. The processes that do the runs know it by
an environment variable.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from framework.errors import require
from framework.files.paths import OWN_VARIABLE

FLAG = "--plugins"


def take_flag(argv: Sequence[str]) -> list[str]:
    """`argv` without `--plugins DIR`, whose folder is searched from now on; without one, none is.

    Raises UserError where DIR is missing, no folder, or named twice.
    """
    rest, folders, words = [], [], iter(argv)
    for word in words:
        flag, equals, folder = word.partition("=")
        if flag == FLAG:
            folders.append(folder if equals else next(words, ""))
        else:
            rest.append(word)
    os.environ.pop(OWN_VARIABLE, None)
    if folders:
        require(len(folders) == 1, f"{FLAG}: expected it once, got it {len(folders)} times")
        require(
            folders[0] != "" and "=" not in folders[0] and Path(folders[0]).is_dir(),
            f"{FLAG}: expected a folder with plugins (.py files), got {folders[0] or 'nothing'!r};"
            f" write {FLAG} DIR, for instance {FLAG} plugins",
        )
        os.environ[OWN_VARIABLE] = str(Path(folders[0]).resolve())
    return rest


def flags() -> list[str]:
    """The words that ask for the same folder again."""
    folder = os.environ.get(OWN_VARIABLE)
    return [] if folder is None else [FLAG, folder]
