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

from framework.files import write_whole
from framework.report.chart import STYLE, Chart, draw
from framework.report.document import Picture

OPTIONS: dict[str, dict[str, Any]] = {
    "svg": {"metadata": {"Date": None}},
    "png": {"metadata": {"Software": None}},
    "jpg": {"pil_kwargs": {"quality": 90, "subsampling": 0}},  # colour edges of maps stay sharp
}
DPI = 110


def chart_picture(out_dir: Path, charts: Sequence[Chart], alt: str, caption: str) -> Picture:
    """Draw the charts into one file of each kind, named after the first."""
    files = save(draw(charts), out_dir, charts[0].name, ("png", "svg"))
    return Picture(files, alt, caption, tuple(charts))


def save(figure: Figure, folder: Path, name: str, formats: Sequence[str]) -> tuple[str, ...]:
    """Write the figure in each format whole and without a date; returns the file names."""
    with matplotlib.rc_context(STYLE):
        for extension in formats:
            buffer = io.BytesIO()
            figure.savefig(buffer, format=extension, dpi=DPI, **OPTIONS[extension])
            write_whole(folder / f"{name}.{extension}", buffer.getvalue())
    return tuple(f"{name}.{extension}" for extension in formats)
