"""Figures of a report: how they are styled and saved, and the chart of PSNR over training time.

Charts are written as PNG and SVG, image grids (`framework.report.images`) as PNG. The palette is
that of Okabe and Ito (2008), which the common forms of colour blindness leave distinct; line styles
repeat what colour says. Files hold no date and no random ids: the same records give the same bytes.
"""

from __future__ import annotations

import io
import re
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from framework.files import write_whole
from framework.report.collect import ReportRun, Study

PALETTE = ("#000000", "#D55E00", "#0072B2", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
LINE_STYLES = ("-", "--", "-.", ":")
STYLE: Any = {"svg.hashsalt": "fishersplat", "svg.fonttype": "path", "font.size": 9.0}
NO_DATE: dict[str, dict[str, Any]] = {"svg": {"Date": None}, "png": {"Software": None}}
DPI = 110


@dataclass(frozen=True)
class DrawnFigure:
    """kind: `images` or `curves`. files: names beside the report, the PNG first."""

    kind: str
    scene: str
    files: tuple[str, ...]
    caption: str


def draw_curves(study: Study, scene: str) -> DrawnFigure | None:
    """Test PSNR against training seconds; None where no history has an evaluation."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(7.0, 4.2), layout="constrained")
        axes = figure.subplots()
        for index, method in enumerate(study.methods):
            _draw_method(
                axes, index, method, [_evaluations(run) for run in study.of(scene, method)]
            )
        if not axes.lines:
            return None
        axes.set_xlabel("training time (s, wall clock, without evaluation)")
        axes.set_ylabel("test PSNR (dB)")
        axes.set_title(scene)
        axes.set_xlim(left=0)
        axes.grid(alpha=0.3, linewidth=0.6)
        figure.legend(loc="outside lower center", ncols=2, frameon=False)
        files = save(figure, study.study_dir, f"curves_{slug(scene)}", ("png", "svg"))
    caption = (
        "Test PSNR at the evaluation steps against training seconds. Bold: mean over seeds of both"
        " at equal steps; thin: single seeds."
    )
    return DrawnFigure("curves", scene, files, caption)


def _draw_method(axes: Axes, index: int, method: str, runs: list[pd.DataFrame]) -> None:
    runs = [run for run in runs if len(run)]
    if not runs:
        return
    color = PALETTE[index % len(PALETTE)]
    style = LINE_STYLES[(index + index // len(PALETTE)) % len(LINE_STYLES)]
    if len(runs) > 1:
        for run in runs:
            axes.plot(
                run["seconds"], run["test_psnr"], style, color=color, alpha=0.35, linewidth=0.8
            )
    mean = pd.concat(runs).groupby("step")[["seconds", "test_psnr"]].agg(["mean", "count"])
    # a mean over fewer seeds at some steps would bend the curve
    mean = mean[mean[("seconds", "count")] == len(runs)]
    label = f"{textwrap.fill(method, 48)} (n = {len(runs)})"
    x, y = mean[("seconds", "mean")], mean[("test_psnr", "mean")]
    axes.plot(x, y, style, color=color, linewidth=2.0, marker="o", markersize=4, label=label)


def _evaluations(run: ReportRun) -> pd.DataFrame:
    history = run.run.history
    return history.loc[history["test_psnr"].notna(), ["step", "seconds", "test_psnr"]]


def save(figure: Figure, folder: Path, name: str, formats: Sequence[str]) -> tuple[str, ...]:
    """Write the figure in each format whole and without a date; returns the file names."""
    for extension in formats:
        buffer = io.BytesIO()
        figure.savefig(
            buffer, format=extension, dpi=DPI, metadata=NO_DATE[extension], bbox_inches="tight"
        )
        write_whole(folder / f"{name}.{extension}", buffer.getvalue())
    return tuple(f"{name}.{extension}" for extension in formats)


def slug(text: str) -> str:
    """`text` as part of a file name."""
    return re.sub(r"[^A-Za-z0-9]+", "_", text).strip("_")
