"""Bands of small pictures with a title each, three to a row, that stay readable at 800 pixels."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

import matplotlib
import numpy as np
from matplotlib.figure import Figure, SubFigure

from framework.report.chart import STYLE, WIDTH

COLUMNS = 3
TITLE_CHARACTERS = 30
LINE_INCHES = 0.17
HEADING_INCHES = 0.62


@dataclass(frozen=True)
class Cell:
    """pixels: [H, W, 3] uint8."""

    title: str
    pixels: np.ndarray


@dataclass(frozen=True)
class Scale:
    """What the colours of the maps mean: `colormap` from 0 to `largest`."""

    title: str
    colormap: str
    largest: float


@dataclass(frozen=True)
class Band:
    """Groups of cells under a heading, each group from a new row on, and the scale of its maps."""

    heading: str
    groups: tuple[tuple[Cell, ...], ...]
    scale: Scale

    @property
    def rows(self) -> list[tuple[Cell, ...]]:
        """The cells, at most `COLUMNS` to a row."""
        starts = [(group, k) for group in self.groups for k in range(0, len(group), COLUMNS)]
        return [group[k : k + COLUMNS] for group, k in starts]


def draw_bands(bands: Sequence[Band]) -> Figure:
    """The bands below each other."""
    heights = [HEADING_INCHES + sum(_row_inches(row) for row in band.rows) for band in bands]
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, sum(heights)))
        parts = figure.subfigures(len(bands), 1, height_ratios=heights, squeeze=False)[:, 0]
        for part, band, height in zip(parts, bands, heights, strict=True):
            _draw_band(part, band, height)
    return figure


def _draw_band(part: SubFigure, band: Band, height: float) -> None:
    part.text(0.005, 1 - 0.08 / height, band.heading, va="top", fontsize=10, fontweight="bold")
    _draw_scale(part, band.scale, height)
    top, width = HEADING_INCHES, 1 / COLUMNS
    for row in band.rows:
        text = _text_inches(row)
        for column, cell in enumerate(row):
            box = _aspect(cell) * WIDTH * width * 0.98
            place = (column * width + 0.003, 1 - (top + text + box) / height, width * 0.98)
            axes = part.add_axes((*place, box / height))
            axes.imshow(cell.pixels, interpolation="nearest", aspect="auto")
            axes.set_axis_off()
            axes.set_title("\n".join(_wrapped(cell.title)), fontsize=9, pad=2.5)
        top += _row_inches(row)


def _draw_scale(part: SubFigure, scale: Scale, height: float) -> None:
    """At the right end of the heading."""
    axes = part.add_axes((0.70, 1 - 0.34 / height, 0.24, 0.11 / height))
    ramp = np.linspace(0, 1, 256)[None]
    axes.imshow(ramp, aspect="auto", cmap=scale.colormap, extent=(0, 1, 0, 1))
    axes.set_yticks([])
    axes.set_xticks([0, 0.5, 1], ["0", f"{scale.largest / 2:g}", f"≥ {scale.largest:g}"])
    axes.tick_params(labelsize=9, length=2, pad=1.5)
    axes.set_title(scale.title, fontsize=9, pad=2.5)


def _row_inches(row: Sequence[Cell]) -> float:
    return _text_inches(row) + max(_aspect(cell) for cell in row) * WIDTH / COLUMNS + 0.04


def _text_inches(row: Sequence[Cell]) -> float:
    return LINE_INCHES * max(len(_wrapped(cell.title)) for cell in row) + 0.06


def _aspect(cell: Cell) -> float:
    return cell.pixels.shape[0] / cell.pixels.shape[1]


def _wrapped(title: str) -> list[str]:
    return [line for part in title.split("\n") for line in textwrap.wrap(part, TITLE_CHARACTERS)]
