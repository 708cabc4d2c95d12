"""Colours, markers and line styles of the methods.

The colours differ in lightness first (Rec. 601 luma at least 25 of 255 apart), so that they stay
apart in greyscale and for the colour-blind; markers and line styles say the same again. On a dark
page the order of lightness is the same from the other end.

A look is a number that stands for colour, marker and line style together. A method keeps its look
in every report: the project's own have theirs in `looks.csv`; any other has one that follows from
its name, moved on only where another series of the same figures has it already.
"""

from __future__ import annotations

import csv
import functools
import hashlib
from collections.abc import Iterable
from pathlib import Path

LIGHT = ("#000000", "#22309A", "#B0301C", "#0E9F84", "#D98A16", "#77C5F0")
DARK = ("#FFFFFF", "#C9DDFB", "#F2B08F", "#38D4B6", "#B27F22", "#525ED0")
MARKERS = ("o", "s", "^", "D", "v", "P")
DASHES = ((), (5, 2), (1.5, 1.5), (7, 2, 1.5, 2))
LOOKS = len(LIGHT) * len(DASHES)


def luma(color: str) -> float:
    """Rec. 601 luma of `#rrggbb`, 0 to 255."""
    red, green, blue = (int(color[k : k + 2], 16) for k in (1, 3, 5))
    return 0.299 * red + 0.587 * green + 0.114 * blue


def looks(names: Iterable[str]) -> dict[str, int]:
    """Name -> look, different ones as long as there are enough."""
    wanted = sorted(set(names))
    known = _known()
    found = {name: known[name] for name in wanted if name in known}
    for name in wanted:
        if name not in found:
            digest = hashlib.sha256(name.encode()).digest()
            first = int.from_bytes(digest[:4], "little")
            ring = [(first + k) % LOOKS for k in range(LOOKS)]
            taken = set(found.values())
            found[name] = next((look for look in ring if look not in taken), ring[0])
    return found


def color_index(look: int) -> int:
    """Which colour a look has."""
    return look % len(LIGHT)


def marker_index(look: int) -> int:
    """Which marker it has; looks of equal colour differ in it."""
    return (look + look // len(LIGHT)) % len(MARKERS)


def dash_index(look: int) -> int:
    """Which line style it has; looks of equal colour differ in it."""
    return (look + look // len(LIGHT)) % len(DASHES)


@functools.cache
def _known() -> dict[str, int]:
    with Path(__file__).with_name("looks.csv").open(encoding="utf-8", newline="") as file:
        return {row["name"]: int(row["look"]) for row in csv.DictReader(file)}
