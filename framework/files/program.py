"""How the user called this program: its name and `--plugins DIR`, for messages and for commands
that are printed.

Both are environment variables, because the processes of launchers print commands and load plugins
too. A plugin is code, so only the command line may name its folder.
"""

from __future__ import annotations

import os
import shlex
from collections.abc import Sequence
from pathlib import Path

from framework.errors import require
from framework.files.paths import OWN_VARIABLE

VARIABLE = "FISHERSPLAT_PROGRAM"
FLAG = "--plugins"


def program() -> str:
    """Return what the user typed: `fishersplat`, `python run.py` or `python DIR/run.py`."""
    return os.environ.get(VARIABLE, "fishersplat")


def set_program(name: str) -> None:
    """Store what `program` returns."""
    os.environ[VARIABLE] = name


def command_line(words: Sequence[str]) -> str:
    """A command to copy: this program with `words`, and with the plugin folder of this one."""
    return f"{program()} {shlex.join([*words, *plugin_flags()])}"


def take_flag(argv: Sequence[str]) -> list[str]:
    """Return `argv` without `--plugins DIR` and search that folder for plugins from now on.

    Raises:
        UserError: DIR is missing, is no folder, or is given twice.
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


def plugin_flags() -> list[str]:
    """Return the words that name the same plugin folder again."""
    folder = os.environ.get(OWN_VARIABLE)
    return [] if folder is None else [FLAG, folder]
