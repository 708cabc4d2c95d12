"""Colours, markers and line styles of the methods.

Colours differ in lightness first (Rec. 601 luma at least 25 of 255 apart), so they remain distinct
in greyscale and for colour-blind readers. Markers and line styles repeat the distinction. On a dark
page the order of lightness is reversed.

A look is a number that selects colour, marker and line style. A method keeps its look in every
report. The looks of the project's methods are in `looks.csv`; any other follows from the method's
name, unless another series of the same figures has it.
"""

import csv
import functools
import hashlib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

LIGHT = ("#000000", "#22309A", "#B0301C", "#0E9F84", "#D98A16", "#77C5F0")
DARK = ("#FFFFFF", "#C9DDFB", "#F2B08F", "#38D4B6", "#B27F22", "#525ED0")
MARKERS = ("o", "s", "^", "D", "v", "P")
DASHES = ((), (5, 2), (1.5, 1.5), (7, 2, 1.5, 2))
LOOKS = len(LIGHT) * len(DASHES)


def looks(names: Iterable[str]) -> dict[str, int]:
    """Name -> look, different ones as long as there are enough."""
    wanted = sorted(set(names))
    fixed = _known()
    chosen = {name: fixed[name] for name in wanted if name in fixed}
    for name in wanted:
        if name not in chosen:
            digest = hashlib.sha256(name.encode()).digest()
            first = int.from_bytes(digest[:4], "little")
            ring = [(first + k) % LOOKS for k in range(LOOKS)]
            taken = set(chosen.values())
            chosen[name] = next((look for look in ring if look not in taken), ring[0])
    return chosen


@dataclass(frozen=True)
class Look:
    """How a series is drawn; looks of equal colour differ in marker and dash."""

    color: str
    marker: str
    dash: Any


def look_of(index: int) -> Look:
    """The look with this index."""
    turn = index + index // len(LIGHT)
    dash = DASHES[turn % len(DASHES)]
    return Look(LIGHT[index % len(LIGHT)], MARKERS[turn % len(MARKERS)], (0, dash) if dash else "-")


@functools.cache
def _known() -> dict[str, int]:
    with Path(__file__).with_name("looks.csv").open(encoding="utf-8", newline="") as file:
        return {row["name"]: int(row["look"]) for row in csv.DictReader(file)}
