"""A grid of small pictures with a title each, three to a row, that stay readable at 800 pixels.

All lengths are pixels of the finished image. A picture is made as wide as its column: a larger one
is averaged down (Lanczos), a smaller one keeps its pixels as squares.
"""

from __future__ import annotations

import functools
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib
import numpy as np
from PIL import Image, ImageDraw, ImageFont

WIDTH, COLUMNS = 792, 3
COLUMN, GAP = WIDTH // COLUMNS, 6
PICTURE = COLUMN - GAP
TITLE_CHARACTERS = 32
TITLE_SIZE, HEADING_SIZE = 13, 15
LINE, HEADING, ROW_GAP = 17, 62, 8
SCALE_BOX = (548, 24, 738, 36)  # left, top, right, bottom within a band
INK, PAPER = (0, 0, 0), (255, 255, 255)


@dataclass(frozen=True)
class Cell:
    """pixels: [H, W, 3] uint8."""

    title: str
    pixels: np.ndarray


@dataclass(frozen=True)
class Band:
    """Groups of cells under a heading, each group from a new row on.

    Attributes:
        largest: the largest error that the colours of error maps show.
    """

    heading: str
    groups: tuple[tuple[Cell, ...], ...]
    largest: float

    @property
    def rows(self) -> list[tuple[Cell, ...]]:
        """The cells, at most `COLUMNS` to a row."""
        starts = [(group, k) for group in self.groups for k in range(0, len(group), COLUMNS)]
        return [group[k : k + COLUMNS] for group, k in starts]


def draw_band(band: Band) -> Image.Image:
    """The cells below the heading."""
    height = HEADING + sum(_row_height(row) for row in band.rows)
    page = Image.new("RGB", (WIDTH, height), PAPER)
    draw = ImageDraw.Draw(page)
    heading = "\n".join(textwrap.wrap(band.heading, 60)[:2])
    draw.multiline_text((4, 10), heading, INK, _font(HEADING_SIZE, bold=True), spacing=3)
    _draw_scale(page, draw, band.largest)
    top = HEADING
    for row in band.rows:
        below_titles = top + _titles_height(row)
        for column, cell in enumerate(row):
            left, lines = column * COLUMN + GAP // 2, _wrapped(cell.title)
            for number, line in enumerate(reversed(lines)):
                place = (left + PICTURE // 2, below_titles - 4 - LINE * number)
                draw.text(place, line, INK, _font(TITLE_SIZE), anchor="ms")
            page.paste(_fitted(cell.pixels), (left, below_titles))
        top += _row_height(row)
    return page


def _draw_scale(page: Image.Image, draw: ImageDraw.ImageDraw, largest: float) -> None:
    """At the right end of the heading: the colours, and what 0, half and all mean."""
    left, top, right, bottom = SCALE_BOX
    width, height = right - left, bottom - top
    ramp = matplotlib.colormaps["magma"](np.linspace(0, 1, width), bytes=True)[:, :3]
    page.paste(Image.fromarray(np.repeat(ramp[None], height, axis=0)), (left, top))
    font = _font(TITLE_SIZE)
    draw.text(((left + right) // 2, top - 5), "mean absolute error", INK, font, anchor="ms")
    ends = ("0", f"{largest / 2:g}", f"≥ {largest:g}")
    for share, text in zip((0.0, 0.5, 1.0), ends, strict=True):
        x = left + round(share * (width - 1))
        draw.line((x, bottom, x, bottom + 3), INK)
        draw.text((x, bottom + 5), text, INK, font, anchor="ma")


def _fitted(pixels: np.ndarray) -> Image.Image:
    shrinks = pixels.shape[1] > PICTURE
    how = Image.Resampling.LANCZOS if shrinks else Image.Resampling.NEAREST
    return Image.fromarray(pixels).resize((PICTURE, _picture_height(pixels)), how)


def _row_height(row: Sequence[Cell]) -> int:
    return _titles_height(row) + max(_picture_height(cell.pixels) for cell in row) + ROW_GAP


def _titles_height(row: Sequence[Cell]) -> int:
    return LINE * max(len(_wrapped(cell.title)) for cell in row) + 2


def _picture_height(pixels: np.ndarray) -> int:
    return max(1, round(PICTURE * pixels.shape[0] / pixels.shape[1]))


def _wrapped(title: str) -> list[str]:
    return [line for part in title.split("\n") for line in textwrap.wrap(part, TITLE_CHARACTERS)]


@functools.cache
def _font(size: int, bold: bool = False) -> ImageFont.FreeTypeFont:
    """The charts' font, which matplotlib brings along."""
    name = f"DejaVuSans{'-Bold' if bold else ''}.ttf"
    path = Path(matplotlib.get_data_path()) / "fonts" / "ttf" / name
    return ImageFont.truetype(str(path), size, layout_engine=ImageFont.Layout.BASIC)
