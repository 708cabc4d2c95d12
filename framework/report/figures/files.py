"""Figures as files: charts as PNG and SVG, grids of photographs as JPEG. Files hold no date and no
random ids: the same records give the same bytes. The widest is 800 pixels, so that text keeps its
size."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.figure import Figure

from framework.files.whole import write_whole
from framework.report.parts.chart import STYLE, Chart, draw
from framework.report.parts.document import Picture
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
    return Picture((f"{name}.png", f"{name}.svg"), alt, caption, tuple(charts))


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
