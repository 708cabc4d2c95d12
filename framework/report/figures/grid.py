"""A grid of small pictures with titles that stays readable at 800 pixels."""

import io
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from framework.report.figures.chart import STYLE

MIN_COLUMNS = 3
WIDTH, DPI = 5.5, 144  # inches; 792 pixels
TITLE_CHARACTERS = 90  # of all titles in a row
HEADING_CHARACTERS = 60
LINE, GAP, HEADING = 0.12, 0.08, 0.45  # inches; the heading is beside the scale of errors
FRAME = "#ffd700"
JPEG = {"quality": 90, "subsampling": 0}  # colour edges of maps stay sharp


@dataclass(frozen=True)
class Cell:
    """A picture.

    Attributes:
        pixels: [H, W, 3] uint8; empty leaves the place blank.
        frame: rows and columns of a part to mark.
    """

    title: str
    pixels: np.ndarray
    frame: tuple[slice, slice] | None = None


def draw_grid(heading: str, rows: Sequence[Sequence[Cell]], largest: float) -> bytes:
    """The pictures below the heading, as JPEG.

    Args:
        rows: three or four cells each, or fewer.
        largest: the largest error that the colours of error maps show.
    """
    columns = max(MIN_COLUMNS, *map(len, rows))
    characters = TITLE_CHARACTERS // columns
    heights = [_height([cell for cell in row if cell.pixels.size], columns) for row in rows]
    height = sum(heights) + HEADING
    with matplotlib.rc_context({**STYLE, "font.size": 7.0, "axes.titlesize": 7.0}):
        figure = Figure(figsize=(WIDTH, height), dpi=DPI)
        margins = {"left": 0.004, "right": 0.996, "bottom": 0.0, "top": 1 - HEADING / height}
        spaces = {"wspace": 0.025, "hspace": 0.0, "height_ratios": heights}
        places = figure.add_gridspec(len(rows), columns, **margins, **spaces)
        for number, row in enumerate(rows):
            for column, cell in enumerate(row):
                _draw_cell(figure.add_subplot(places[number, column]), cell, characters)
        lines = "\n".join(textwrap.wrap(heading, HEADING_CHARACTERS)[:2])
        figure.text(0.005, 1 - 0.07 / height, lines, weight="bold", va="top")
        _draw_scale(figure, largest)
        buffer = io.BytesIO()
        figure.savefig(buffer, format="jpeg", pil_kwargs=JPEG)
    return buffer.getvalue()


def _draw_cell(axes: Axes, cell: Cell, characters: int) -> None:
    axes.set_axis_off()
    if cell.pixels.size:
        axes.imshow(cell.pixels, interpolation="antialiased", interpolation_stage="rgba")
        axes.set_anchor("S")
        if cell.frame is not None:
            rows, columns = cell.frame
            size = columns.stop - columns.start, rows.stop - rows.start
            corner = columns.start - 0.5, rows.start - 0.5
            axes.add_patch(Rectangle(corner, *size, fill=False, edgecolor=FRAME, linewidth=1.2))
        axes.set_title(textwrap.fill(cell.title, characters, replace_whitespace=False), pad=3)


def _draw_scale(figure: Figure, largest: float) -> None:
    """The colours of error maps, and what 0, half and all mean."""
    height = figure.get_figheight()
    axes = figure.add_axes((0.69, 1 - 0.24 / height, 0.24, 0.08 / height))
    colors = ScalarMappable(Normalize(0, largest), "magma")
    scale = figure.colorbar(colors, axes, orientation="horizontal", ticks=[0, largest / 2, largest])
    scale.set_ticks([0, largest / 2, largest], labels=["0", f"{largest / 2:g}", f"≥ {largest:g}"])
    scale.ax.set_title("mean absolute error", fontsize=7, pad=2)


def _height(row: Sequence[Cell], columns: int) -> float:
    """Inches of the highest picture with its title."""
    aspect = max(len(cell.pixels) / len(cell.pixels[0]) for cell in row)
    lines = max(cell.title.count("\n") + bool(cell.title) for cell in row)
    return aspect * WIDTH / columns + LINE * lines + GAP
