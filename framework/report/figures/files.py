"""Figures as files: charts as PNG, SVG and the numbers in them as CSV, grids of photographs as
JPEG. Files hold no date and no random ids: the same records give the same bytes. The widest is 800
pixels, so that text keeps its size."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.figure import Figure

from framework.files.whole import write_whole
from framework.report.parts.chart import Chart, csv_rows
from framework.report.parts.document import Picture
from framework.report.parts.draw import STYLE, draw
from framework.report.parts.forest import Forest
from framework.report.parts.forest import csv_rows as forest_rows
from framework.report.parts.forest import draw as draw_forest
from framework.report.parts.grid import Band, draw_bands

OPTIONS: dict[str, dict[str, Any]] = {
    "svg": {"metadata": {"Date": None}},
    "png": {"metadata": {"Software": None}},
}
JPEG: dict[str, Any] = {"quality": 90, "subsampling": 0}  # colour edges of maps stay sharp
DPI = 110


def chart_picture(out_dir: Path, charts: Sequence[Chart], alt: str, caption: str) -> Picture:
    """Draw the charts into one file of each kind, named after the first."""
    name = charts[0].name
    _save(draw(charts), out_dir, name)
    _save_numbers(out_dir, name, [row for chart in charts for row in csv_rows(chart)])
    return Picture(_files(name), alt, caption, tuple(charts))


def forest_picture(out_dir: Path, forest: Forest, alt: str, caption: str) -> Picture:
    """Draw a forest plot into one file of each kind."""
    _save(draw_forest(forest), out_dir, forest.name)
    _save_numbers(out_dir, forest.name, forest_rows(forest))
    return Picture(_files(forest.name), alt, caption, forest=forest)


def _files(name: str) -> tuple[str, ...]:
    return tuple(f"{name}.{kind}" for kind in ("png", "svg", "csv"))


def _save_numbers(out_dir: Path, name: str, rows: Sequence[Mapping[str, object]]) -> None:
    buffer = io.StringIO()
    writer = csv.DictWriter(buffer, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_whole(out_dir / f"{name}.csv", buffer.getvalue())


def grid_picture(
    out_dir: Path, name: str, bands: Sequence[Band], alt: str, caption: str, in_viewer: bool
) -> Picture:
    """Draw the bands into a JPEG. in_viewer: whether the page's viewer shows these images."""
    buffer = io.BytesIO()
    draw_bands(bands).save(buffer, format="JPEG", **JPEG)
    write_whole(out_dir / f"{name}.jpg", buffer.getvalue())
    return Picture((f"{name}.jpg",), alt, caption, grid=in_viewer)


def _save(figure: Figure, folder: Path, name: str) -> None:
    with matplotlib.rc_context(STYLE):
        for extension, options in OPTIONS.items():
            buffer = io.BytesIO()
            figure.savefig(buffer, format=extension, dpi=DPI, **options)
            write_whole(folder / f"{name}.{extension}", buffer.getvalue())
