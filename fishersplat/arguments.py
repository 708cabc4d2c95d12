"""Checks of what a Python caller may hand over and a command line cannot."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from framework.command.complaints import EACH
from framework.command.config.composed import Configuration, configuration
from framework.errors import UserError, require

MULTIRUN = re.compile(rf"{re.escape(EACH)}|(write )?\S+ -m for a run of each")


def expect(good: bool, where: str, expected: str, got: Any, advice: str) -> None:
    """Raise UserError, with the value and its type, unless `good`."""
    kind = "" if got is None else f" ({type(got).__name__})"
    require(good, f"{where}: expected {expected}, got {got!r:.80}{kind}; {advice}")


def expect_folder(where: str, path: Any, example: str) -> Path:
    """The folder as a Path. Raises UserError for anything but a path."""
    expect(isinstance(path, str | os.PathLike), where, "a folder", path, f"give one as {example}")
    return Path(path)


def composed(where: str, options: Sequence[str]) -> Configuration:
    """Compose the configuration of one run; advice to add -m becomes advice to call again.

    Raises:
        UserError: an option is no text, unknown or invalid, or describes more than one run.
    """
    for word in options:
        advice = f"give each as its own argument, {where}(*options)"
        expect(isinstance(word, str), where, "options as texts such as 'reg=uar'", word, advice)
    try:
        return configuration(options)
    except UserError as error:
        again = f"call {where}(...) once for each"
        raise UserError(MULTIRUN.sub(again, str(error))) from None
