"""Draw the packages of `framework/` and their imports: `python docs/rooms.py [FOLDER]`.

The order is that of `ROOMS` in tests/contract/test_imports.py. Each package has a vertical line to
its right; a dot connects it to a package that it imports. The same files give the same bytes.
"""

from __future__ import annotations

import ast
import re
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure

ROOT = Path(__file__).resolve().parent.parent
ORDER = ROOT / "tests" / "contract" / "test_imports.py"
PLUGINS, BESIDE = "plugins", "toolbox"  # drawn above this package

WIDTH, ROW, HEAD = 1200, 42, 44  # pixels
BOX, FIRST_WIRE, WIRE_STEP = 630, 652, 21  # where boxes end, the lowest room's wire, to the next
INTO, OUT = -7, 8  # where arrows end and wires begin, from the middle of a box
COLOURS = ("#0b5fa5", "#b3501c", "#1f7a4d", "#7a3b9b", "#8a6d00", "#a12a5e")
LEGEND = "A dot on a line: its package imports the package to the left of the dot."
STYLE: dict[Any, Any] = {
    "font.family": ["DejaVu Sans", "sans-serif"],
    "svg.hashsalt": "rooms",
    "svg.fonttype": "none",
}
WITHOUT_DATE = {"png": {"Software": None}, "svg": {"Date": None}}


@dataclass(frozen=True)
class Room:
    """A row of the picture. imports: names of the rooms that its files import."""

    name: str
    purpose: str
    files: int
    lines: int
    imports: frozenset[str]


def rooms() -> list[Room]:
    """Top to bottom."""
    text = ORDER.read_text(encoding="utf-8")
    block = text[text.index("ROOMS = (") :].partition("\n)")[0]
    named = re.findall(r'^    "(\w+)",(?:  # ([^;\n]+))?', block, re.MULTILINE)
    at = next(i for i, (name, _) in enumerate(named) if name == BESIDE)
    named.insert(at, (PLUGINS, "one file per method"))
    return [_room(name, purpose) for name, purpose in named]


def _room(name: str, purpose: str) -> Room:
    folder = ROOT / PLUGINS if name == PLUGINS else ROOT / "framework" / name
    files = sorted(folder.rglob("*.py")) or [folder.with_suffix(".py")]
    texts = [file.read_text(encoding="utf-8") for file in files]
    imports = frozenset[str]().union(*map(_imports, texts)) - {name}
    return Room(name, purpose, len(files), sum(t.count("\n") for t in texts), imports)


def _imports(text: str) -> set[str]:
    """The rooms that a file imports, wherever the statement stands."""
    modules = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            modules |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            modules |= {f"{node.module}.{alias.name}" for alias in node.names}
    inside = {name.split(".")[1] for name in modules if name.startswith("framework.")}
    return {name for name in inside if not name.startswith("__")}  # `framework.__version__`


def picture(rows: list[Room]) -> Figure:
    """One row per room, `WIDTH` pixels wide at 100 dots per inch."""
    height = HEAD + ROW * len(rows)
    figure = Figure(figsize=(WIDTH / 100, height / 100), dpi=100)
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set(xlim=(0, WIDTH), ylim=(height, 0))
    axes.axis("off")
    axes.text(8, 20, LEGEND, va="center", fontsize=9.5, color="#444c54")
    middle = {room.name: HEAD + ROW * (i + 0.5) - 7 for i, room in enumerate(rows)}
    for i, room in enumerate(rows):
        _draw_box(axes, room, middle[room.name])
        x = FIRST_WIRE + WIRE_STEP * (len(rows) - 2 - i)  # upper rooms' wires are farther right
        _draw_wire(axes, x, COLOURS[i % len(COLOURS)], middle, room)
    return figure


def _draw_box(axes: Axes, room: Room, y: float) -> None:
    place = (8, y - 16), BOX - 8, 32
    colour = "#fff4e0" if room.name == PLUGINS else "#f2f5f8"
    axes.add_patch(matplotlib.patches.Rectangle(*place, fc=colour, ec="#5b6670", lw=1))
    size = f"{room.files} file{'s' * (room.files > 1)}, {room.lines:,} lines"
    axes.text(18, y, room.name, va="center", fontsize=11, weight="bold")
    axes.text(112, y, room.purpose.replace("->", "\N{RIGHTWARDS ARROW}"), va="center", fontsize=9.5)
    axes.text(BOX - 8, y, size, va="center", ha="right", fontsize=8.5, color="#444c54")


def _draw_wire(axes: Axes, x: float, colour: str, middle: dict[str, float], room: Room) -> None:
    """The wire of a room at `x`, its dots, and thin arrows from there into what it imports."""
    ends = sorted(middle[name] + INTO for name in room.imports)
    if not ends:
        return
    start = middle[room.name] + OUT
    axes.plot([BOX, x, x], [start, start, ends[-1]], color=colour, lw=1.4, zorder=2)
    axes.scatter([x] * len(ends), ends, s=22, color=colour, zorder=3)
    for y in ends:
        arrow = {"arrowstyle": "-|>", "color": "#b4bcc4", "lw": 1, "shrinkA": 0, "shrinkB": 0}
        axes.annotate("", (BOX, y), (x, y), arrowprops=arrow, zorder=1)


def main(folder: Path) -> None:
    """Write rooms.png and rooms.svg into `folder`."""
    with matplotlib.rc_context(STYLE):
        for kind, metadata in WITHOUT_DATE.items():
            picture(rooms()).savefig(folder / f"rooms.{kind}", metadata=metadata)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).resolve().parent)
