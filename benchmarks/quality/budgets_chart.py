"""The charts of `budgets.py`: PSNR against CPU seconds and against parameters."""

from __future__ import annotations

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

FORWARD = ("fern", "horns", "fortress", "room")
OPENSPLAT = (1293.0, 20.07)  # CPU seconds, dB: fern, 3 photos, 2,000 steps, flags that densify
# LLFF, 3 photos, the mean of fern, horns, fortress and room as reruns published them (ReDI-GS's
# ablation notes; FSGS, Binocular3DGS and ReDI-GS with their seconds on an NVIDIA A4000)
LABEL_DB, LABEL_RANGE_DB = 0.6, 15  # from one label to the next; what three inches show
PUBLISHED = {"FSGS": (2724.0, 21.79), "Binocular3DGS": (1483.0, 22.84), "ReDI-GS": (676.0, 23.36)}


def chart(points: pd.DataFrame) -> Figure:
    """PSNR against CPU seconds and against parameters: scenes faint, their mean strong; on the
    right the forward-facing four beside what was published, which GPUs made."""
    with matplotlib.rc_context({"font.size": 9, "svg.hashsalt": "fishersplat"}):
        figure = Figure(figsize=(12, 4), layout="constrained")
        panels = figure.subplots(1, 3)
        for axes, column, name in (
            (panels[0], "train_cpu_s", "CPU seconds of the training"),
            (panels[1], "parameters", "parameters"),
        ):
            ends = points.sort_values("train_cpu_s").groupby("place").tail(1).sort_values("psnr")
            for _, rows in points.groupby("place", sort=False):
                rows = rows.sort_values("train_cpu_s")  # in the order of the presets
                axes.plot(rows[column], rows["psnr"], color="0.75", lw=1)
            height = -np.inf
            for last in ends.itertuples():
                height = max(last.psnr, height + LABEL_DB)
                axes.annotate(
                    last.place,
                    (getattr(last, column), last.psnr),
                    (3, (height - last.psnr) * 72 * 3 / LABEL_RANGE_DB),
                    textcoords="offset points",
                    fontsize=7,
                    color="0.4",
                    va="center",
                )
            _strong(axes, points, column, "mean")
            axes.set(xscale="log", xlabel=name, ylabel="test PSNR, dB")
            axes.xaxis.set_minor_formatter(NullFormatter())
            axes.margins(x=0.25, y=0.08)
        _against_published(panels[2], points[points["place"].isin(FORWARD)])
    return figure


def _strong(axes: Axes, points: pd.DataFrame, column: str, name: str) -> None:
    """The mean of the presets that all scenes have."""
    scenes = points["place"].nunique()
    points = points[points.groupby("preset")["place"].transform("nunique") == scenes]
    mean = points.groupby("preset")[[column, "psnr"]].mean().sort_values(column)
    axes.plot(mean[column], mean["psnr"], "o-", color="#1f6fb4", lw=2, label=name)
    for preset, row in mean.iterrows():
        axes.annotate(
            preset,
            (row[column], row["psnr"]),
            fontsize=8,
            color="#1f6fb4",
            xytext=(0, 6),
            textcoords="offset points",
            ha="center",
        )


def _against_published(axes: Axes, points: pd.DataFrame) -> None:
    _strong(axes, points, "train_cpu_s", "here")
    for name, (seconds, psnr) in PUBLISHED.items():
        axes.plot(seconds, psnr, "s", color="#b4531f", ms=5)
        axes.annotate(
            f"{name}, GPU",
            (seconds, psnr),
            fontsize=8,
            color="#b4531f",
            xytext=(0, -11),
            textcoords="offset points",
            ha="center",
        )
    _fern_alone(axes, points)
    axes.plot(*OPENSPLAT, "^", color="0.3", ms=6)
    axes.annotate(
        "OpenSplat, CPU, fern",
        OPENSPLAT,
        fontsize=8,
        color="0.3",
        xytext=(0, 7),
        textcoords="offset points",
        ha="center",
    )
    axes.set(
        xscale="log",
        xlabel="seconds: CPU (blue, grey), GPU (squares)",
        ylabel="test PSNR, dB",
        title="fern, horns, fortress, room; 3 photos",
    )
    axes.margins(x=0.18, y=0.12)


def _fern_alone(axes: Axes, points: pd.DataFrame) -> None:
    fern = points[points["place"] == "fern"].sort_values("train_cpu_s")
    if not len(fern):
        return
    axes.plot(fern["train_cpu_s"], fern["psnr"], color="0.6", lw=1)
    last = fern.iloc[-1]
    axes.annotate(
        "fern alone",
        (last["train_cpu_s"], last["psnr"]),
        fontsize=7,
        color="0.4",
        xytext=(3, 2),
        textcoords="offset points",
    )
