"""Colours, markers and line styles of the methods.

The colours differ in lightness first (Rec. 601 luma at least 25 of 255 apart), so that they stay
apart in greyscale and for the colour-blind; markers and line styles say the same again. On a dark
page the order of lightness is the same from the other end.
"""

from __future__ import annotations

LIGHT = ("#000000", "#22309A", "#B0301C", "#0E9F84", "#D98A16", "#77C5F0")
DARK = ("#FFFFFF", "#C9DDFB", "#F2B08F", "#38D4B6", "#B27F22", "#525ED0")
MARKERS = ("o", "s", "^", "D", "v", "P")
DASHES = ((), (5, 2), (1.5, 1.5), (7, 2, 1.5, 2))


def luma(color: str) -> float:
    """Rec. 601 luma of `#rrggbb`, 0 to 255."""
    red, green, blue = (int(color[k : k + 2], 16) for k in (1, 3, 5))
    return 0.299 * red + 0.587 * green + 0.114 * blue


def color_index(index: int) -> int:
    """Which colour and marker the method at `index` has."""
    return index % len(LIGHT)


def dash_index(index: int) -> int:
    """Which line style it has; methods of equal colour differ in it."""
    return (index + index // len(LIGHT)) % len(DASHES)
