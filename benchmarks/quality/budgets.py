"""Do more steps, more photos and dearer presets help, and what do they cost?

    python benchmarks/quality/budgets.py --data DIR --studies DIR [--ask time views presets]
        [--seeds 0,1,2] [--steps 100,300,1000,3000,10000] [--presets fast,balanced,best] [--lpips]
        [--run] [--output FILE.md]

DIR of --data holds the scenes of `SCENES` by name. With --run every study is done by `run.py`, one
process and thread, into the folder of --studies; what is complete there is kept, so a second call
goes on, with more seeds if they are given. Without it, what is there is put in tables, and for the
presets in a chart beside FILE.md. Time and views are asked at half the photos' size. Seconds are
CPU seconds of the training, as other programs disturb them less than the clock; memory is the peak
of the process. --lpips: of the presets' runs LPIPS (VGG) is measured too, by the weights that
`fishersplat fetch lpips` fetched.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from framework.report.study.roles import CHOSE, role

ROOT = Path(__file__).resolve().parents[2]
PRESETS = ("fast", "balanced", "best", "long")
STEPS = {"fast": 75, "balanced": 600, "best": 2400, "long": 12000}  # conf/preset
TOLERANCE_DB = 0.1  # by which a longer training may be below a shorter one
FORWARD = ("fern", "horns", "fortress", "room")
OPENSPLAT = (1293.0, 20.07)  # CPU seconds, dB: fern, 3 photos, 2,000 steps, flags that densify
# LLFF, 3 photos, the mean of fern, horns, fortress and room as reruns published them (ReDI-GS's
# ablation notes; FSGS, Binocular3DGS and ReDI-GS with their seconds on an NVIDIA A4000)
PUBLISHED = {"FSGS": (2724.0, 21.79), "Binocular3DGS": (1483.0, 22.84), "ReDI-GS": (676.0, 23.36)}


@dataclass(frozen=True)
class Place:
    """A scene: what run.py is told, and its usual number of training views."""

    words: str
    views: int

    def bold(self, name: str) -> str:
        """`name` in bold if the scene chose no setting, by the folder that it is read from."""
        folder = self.words.split("{}/")[1].split()[0]
        return name if role(folder) == CHOSE else f"**{name}**"


SCENES = {
    "fern": Place("scene=llff scene.path={}/llff_fern", 3),
    "horns": Place("scene=llff scene.path={}/llff_horns", 3),
    "fortress": Place("scene=llff scene.path={}/llff_fortress", 3),
    "room": Place("scene=llff scene.path={}/llff_room", 3),
    "scan65": Place("scene=dtu scene.path={}/dtu_scan65", 3),
    "scan24": Place("scene=dtu scene.path={}/dtu_scan24", 3),
    "door": Place("scene=colmap scene.path={}/lund_door", 3),
    "kitchen": Place("scene=mip360 scene.path={}/mip360_kitchen scene.images=images_4", 12),
    "fox12": Place("scene=transforms scene.path={}/nerf_fox", 12),
    "fox43": Place("scene=transforms scene.path={}/nerf_fox", 43),
}
VIEWS = {
    "fox": ("fox12", ("3", "6", "12", "24", "43")),
    "kitchen": ("kitchen", ("6", "12", "21")),
    "horns": ("horns", ("3", "6", "9", "24", "all")),
}


def commands(
    ask: str, data: Path, seeds: str, steps: str, presets: str, lpips: bool
) -> list[list[str]]:
    """The words for run.py of one question."""
    usual = ["threads=1", "trainer.evaluations=1", f"seed={seeds}"]
    if not (lpips and ask == "presets"):
        usual.append("metrics.lpips_weights=none")
    made = []
    if ask == "views":
        for name, (scene, numbers) in VIEWS.items():
            words = SCENES[scene].words.format(data).split()
            views = f"scene.n_views={','.join(numbers)}"
            made.append(
                [*words, views, "scene.downscale=2", f"preset={presets}", f"study=views_{name}"]
            )
    else:
        for name, place in SCENES.items():
            words = [*place.words.format(data).split(), f"scene.n_views={place.views}"]
            asked = (
                ["scene.downscale=2", f"trainer.steps={steps}"]
                if ask == "time"
                else [f"preset={presets}"]
            )
            made.append([*words, *asked, f"study={ask}_{name}"])
    return [[*words, *usual, "-m"] for words in made]


def runs(studies: Path, study: str) -> pd.DataFrame:
    """The complete runs of a study, an empty table where there is none."""
    file = studies / study / "runs.csv"
    if not file.exists():
        return pd.DataFrame()
    table = pd.read_csv(file)
    for option in ("n_views", "downscale"):
        found = table["overrides"].str.extract(rf"scene\.{option}=(\S+)")[0]
        table[option] = found
    table["preset"] = table["overrides"].str.extract(r"preset=(\w+)")[0]
    table["steps"] = table["overrides"].str.extract(r"trainer\.steps=(\d+)")[0].astype(float)
    folder = studies / study / "runs"
    table["memory_mb"] = [memory_mb(folder / str(run) / "record.json") for run in table["run"]]
    return table.dropna(subset=["psnr"])


def memory_mb(record: Path) -> float:
    """What the process of a run had at its most."""
    return json.loads(record.read_text())["peak_memory_bytes"] / 1e6 if record.exists() else np.nan


def told(values: pd.Series, digits: int = 2) -> str:
    """Mean and, of several seeds, their standard deviation."""
    if values.empty:
        return "-"
    spread = f" ± {values.std():.2f}" if len(values) > 1 else ""
    return f"{values.mean():.{digits}f}{spread}"


def named(scene: str) -> str:
    return SCENES[scene].bold(scene)


def time_table(studies: Path) -> list[str]:
    tables = {scene: runs(studies, f"time_{scene}") for scene in SCENES}
    counts = sorted({int(n) for t in tables.values() if len(t) for n in t["steps"]})
    lines = [
        "| scene, views | "
        + " | ".join(f"{n:,}" for n in counts)
        + " | seeds | Gaussians, MB, of the longest | worst step back, dB |",
        "|---|" + "---:|" * (len(counts) + 3),
    ]
    for scene, table in tables.items():
        if not len(table):
            continue
        groups = {n: table[table["steps"] == n] for n in counts}
        cells = [
            f"{told(g['psnr'])}, {g['train_cpu_s'].mean():.0f} s" if len(g) else "-"
            for g in groups.values()
        ]
        means = [g["psnr"].mean() for g in groups.values() if len(g)]
        back = min((b - a for i, a in enumerate(means) for b in means[i + 1 :]), default=0.0)
        shown = f"{back:.2f}" if back < -TOLERANCE_DB else "none"
        n = table.groupby("steps")["seed"].nunique()
        seeds = f"{n.min()}" if n.min() == n.max() else f"{n.min()} to {n.max()}"
        longest = table[table["steps"] == table["steps"].max()]
        size = f"{longest['gaussians'].mean():,.0f}, {longest['memory_mb'].max():,.0f}"
        name = f"{named(scene)}, {SCENES[scene].views}"
        lines.append(f"| {name} | {' | '.join(cells)} | {seeds} | {size} | {shown} |")
    return lines


def views_table(studies: Path) -> list[str]:
    lines = [
        "| scene, views | " + " | ".join(PRESETS[:3]) + " | seeds |",
        "|---|---:|---:|---:|---:|",
    ]
    for name, (scene, numbers) in VIEWS.items():
        table = runs(studies, f"views_{name}")
        for number in numbers:
            rows = table[table["n_views"] == number] if len(table) else table
            if not len(rows):
                continue
            cells = []
            for preset in PRESETS[:3]:
                g = rows[rows["preset"] == preset]
                cells.append(
                    f"{told(g['psnr'])}, {g['train_cpu_s'].mean():.0f} s" if len(g) else "-"
                )
            seeds = rows["seed"].nunique()
            lines.append(
                f"| {SCENES[scene].bold(name)}, {number} | {' | '.join(cells)} | {seeds} |"
            )
    return lines


def presets_table(studies: Path) -> tuple[list[str], pd.DataFrame]:
    """The lines, and (scene, preset, psnr, train_cpu_s, parameters, ...) by mean over seeds."""
    parts = []
    for scene in SCENES:
        table = runs(studies, f"presets_{scene}")
        if len(table):
            parts.append(table.assign(place=scene))
    if not parts:
        return [], pd.DataFrame()
    every = pd.concat(parts)
    have = [p for p in PRESETS if p in set(every["preset"])]
    lines = [
        "| scene, views | "
        + " | ".join(f"`{p}` ({STEPS[p]:,} steps)" for p in have)
        + " | seeds | MB |",
        "|---|" + "---|" * len(have) + "---:|---:|",
    ]
    for scene, table in every.groupby("place", sort=False):
        cells = []
        for preset in have:
            g = table[table["preset"] == preset]
            cost = f"{sharpness(g)}{g['train_cpu_s'].mean():.0f} s, {g['gaussians'].mean():,.0f}"
            cells.append(f"{told(g['psnr'])} dB, {cost}" if len(g) else "-")
        seeds = table["seed"].nunique()
        size = f"{seeds} | {table['memory_mb'].max():,.0f}"
        lines.append(f"| {named(scene)}, {SCENES[scene].views} | {' | '.join(cells)} | {size} |")
    columns = ["psnr", "ssim", "lpips_01", "train_cpu_s", "gaussians", "parameters"]
    means = every.groupby(["place", "preset"], sort=False)[columns].mean().reset_index()
    complete = means.groupby("place")["preset"].nunique() == len(have)
    both = means[means["place"].isin(complete[complete].index)]
    over = both.groupby("preset")[columns].mean().reindex(have)
    n = both["place"].nunique()
    cells = [
        f"{r.psnr:.2f} dB, {r.lpips_01:.3f}, {r.train_cpu_s:.0f} s, {r.gaussians:,.0f}"
        for r in over.itertuples()
    ]
    lines.append(f"| mean of {n} scenes | {' | '.join(cells)} | | |")
    llff = both[both["place"].isin(FORWARD)].groupby("preset")[columns].mean().reindex(have)
    cells = [f"{r.psnr:.2f} dB, {r.lpips_01:.3f}, {r.train_cpu_s:.0f} s" for r in llff.itertuples()]
    lines.append(f"| mean of {', '.join(FORWARD)} | {' | '.join(cells)} | | |")
    return lines, both


def sharpness(group: pd.DataFrame) -> str:
    """LPIPS as papers feed it, images in [0, 1], of the runs that have it."""
    return f"{group['lpips_01'].mean():.3f}, " if group["lpips_01"].notna().any() else ""


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
            for scene, rows in points.groupby("place", sort=False):
                rows = rows.sort_values("train_cpu_s")  # in the order of the presets
                axes.plot(rows[column], rows["psnr"], color="0.75", lw=1)
                last = rows.iloc[-1]
                axes.annotate(
                    scene,
                    (last[column], last["psnr"]),
                    fontsize=7,
                    color="0.4",
                    xytext=(3, 0),
                    textcoords="offset points",
                    va="center",
                )
            _strong(axes, points, column, "mean")
            axes.set(xscale="log", xlabel=name, ylabel="test PSNR, dB")
            axes.xaxis.set_minor_formatter(NullFormatter())
            axes.margins(x=0.25)
        _against_published(panels[2], points[points["place"].isin(FORWARD)])
    return figure


def _strong(axes: Axes, points: pd.DataFrame, column: str, name: str) -> None:
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
    fern = points[points["place"] == "fern"].sort_values("train_cpu_s")
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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path)
    parser.add_argument("--studies", type=Path, required=True)
    parser.add_argument("--ask", nargs="+", default=["time", "views", "presets"])
    parser.add_argument("--seeds", default="0,1,2")
    parser.add_argument("--steps", default="100,300,1000,3000,10000")
    parser.add_argument("--presets", default="fast,balanced,best")
    parser.add_argument("--lpips", action="store_true", help="of the presets' runs")
    parser.add_argument("--run", action="store_true")
    parser.add_argument("--output", type=Path)
    given = parser.parse_args()
    if given.run:
        for ask in given.ask:
            for words in commands(
                ask, given.data, given.seeds, given.steps, given.presets, given.lpips
            ):
                where = f"hydra.sweep.dir={given.studies}"
                command = [sys.executable, str(ROOT / "run.py"), *words[:-1], where, "-m"]
                subprocess.run(command, check=False)  # what failed is told there, and missing here
    if not list(given.studies.glob("*/runs.csv")):
        parser.error(f"--studies {given.studies}: expected studies made with --run, found none")
    lines: list[str] = []
    for ask in given.ask:
        lines += ["", f"## {ask.capitalize()}", ""]
        if ask == "presets":
            table, points = presets_table(given.studies)
            lines += table
            if given.output and len(points):
                picture = given.output.with_suffix(".png")
                chart(points).savefig(picture, dpi=110, metadata={"Software": None})
        else:
            lines += time_table(given.studies) if ask == "time" else views_table(given.studies)
    text = "\n".join(lines[1:]) + "\n"
    print(text)
    if given.output:
        given.output.write_text(text)


if __name__ == "__main__":
    main()
