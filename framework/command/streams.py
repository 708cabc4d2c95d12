"""Standard streams that are there and take any letter."""

from __future__ import annotations

import contextlib
import io
import os
import sys


def make_safe() -> None:
    """Keep a closed stdout or stderr, or one that cannot encode a letter, from raising."""
    with contextlib.suppress(OSError):
        while os.open(os.devnull, os.O_RDWR) <= 2:  # takes the lowest number that is free
            pass
    for name in ("stdin", "stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:  # was closed at the start
            setattr(sys, name, open(os.devnull, "r" if name == "stdin" else "w"))  # noqa: SIM115
        elif name != "stdin" and type(stream) is io.TextIOWrapper:
            stream.reconfigure(errors="backslashreplace")
