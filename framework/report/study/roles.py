"""Which scenes the project's defaults were chosen on, and which only test them: `scenes.csv`.

A figure on a scene that chose a default flatters that default. Of scenes that helped, training
photos that were held out took part in a choice, and no test photo did. Scenes the file does not
name are the user's own: they chose nothing either.
"""

from __future__ import annotations

import csv
import functools
from collections.abc import Sequence
from pathlib import Path

from framework.report.study.labels import listed

CHOSE, HELPED, TESTS, YOURS = "chose", "helped", "tests", "yours"
MARK = "°"  # after the name of a scene that chose defaults
FILE = Path(__file__).with_name("scenes.csv")


def role(name: str) -> str:
    """`CHOSE`, `HELPED`, `TESTS` or `YOURS`, by the name in the scene's record."""
    return _roles().get(name, YOURS)


def marked(label: str, name: str) -> str:
    """A scene's label, with `MARK` where it chose defaults."""
    return f"{label} {MARK}" if role(name) == CHOSE else label


def roles_sentence(names: Sequence[str]) -> str:
    """Which of the scenes are which."""
    by_role = {
        which: [name for name in names if role(name) == which]
        for which in (CHOSE, HELPED, TESTS, YOURS)
    }
    mark = f" (marked {MARK})" if len(names) > 1 else ""
    told = {
        CHOSE: f"served to choose this project's defaults{mark}, which flatters them there",
        HELPED: "helped to choose settings by training photos that were held out, by no test photo",
        TESTS: "only tested: no default was chosen there",
        YOURS: "of your own",
    }
    parts = [f"{listed(found, 'and')} {told[which]}" for which, found in by_role.items() if found]
    return f"Scenes: {'; '.join(parts)}."


@functools.cache
def _roles() -> dict[str, str]:
    with FILE.open(encoding="utf-8", newline="") as file:
        return {row["scene"]: row["role"] for row in csv.DictReader(file)}
