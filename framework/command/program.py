"""What the user types to call this program, for messages and for commands that are told again."""

from __future__ import annotations

import os

VARIABLE = "FISHERSPLAT_PROGRAM"  # launchers' processes tell commands too
CONSOLE, SCRIPT = "fishersplat", "python run.py"


def program() -> str:
    """`fishersplat` where that was typed, else `python run.py`."""
    return CONSOLE if os.environ.get(VARIABLE) == CONSOLE else SCRIPT


def typed(name: str) -> None:
    """Remember the name that this process was called by."""
    os.environ[VARIABLE] = CONSOLE if name == CONSOLE else SCRIPT
