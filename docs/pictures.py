"""Draw the pictures of README and findings.

    python docs/pictures.py               # charts, from the committed records
    python docs/pictures.py RUN VIDEO     # also the animation: photos of RUN next to VIDEO

VIDEO is an animated WebP file that `fishersplat video RUN --out VIDEO` wrote. Only pictures of the
built-in scene may be published.
"""

from __future__ import annotations

import json
import math
import sys
from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator
from PIL import Image
from scipy import stats

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))  # this checkout's packages

from benchmarks import quoted  # noqa: E402

COMMITTED, IMAGES = ROOT / "reports" / "committed", ROOT / "docs" / "images"
GREEN, GREY = "#0f9b7a", "#44546a"
PRESETS = {  # method of study `speed` -> display name
    "Baseline, kept=1, steps=150": "fast",
    "Baseline, kept=1, steps=600": "balanced",
    "Baseline, kept=1, steps=2400": "best",
}
FULL_SIZE = {  # method of study `depth` -> display name
    "Baseline, steps=600": "balanced",
    "Baseline, steps=2400": "best",
}
METHODS = {  # (augmenter, regularizer) in the records -> display name, in the order of the charts
    ("none", "uniform"): "Uniform dropout",
    ("none", "dropgaussian"): "DropGaussian",
    ("dba", "none"): "DBA",
    ("euclidean", "none"): "Euclidean",
    ("full_set", "none"): "Full set",
    ("safi", "none"): "SAFI",
    ("none", "uar_hard"): "UAR (hard)",
    ("none", "uar"): "UAR",
    ("safi", "uar"): "SAFI + UAR",
}
OURS = ("SAFI", "UAR (hard)", "UAR", "SAFI + UAR")
BASELINE = ("none", "none")
PLUGIN = '''@register("reg", "small")
@dataclass(frozen=True)
class Small(Regularizer):
    """Penalize the mean opacity."""

    defaults = {"weight": 0.001}

    def loss(self, ctx, state, view, render):
        return ctx.gaussians.opacities.mean()
'''
HELP = """$ fishersplat --plugins mine --help reg=small
reg=small: pull opacities towards zero.

reg:
  name: small
  weight: 0.001   # factor of the loss term
  start: 0.0      # share of the training ...
  stop: 1.0

$ fishersplat --plugins mine reg=none,small seed=0,1,2 -m
"""

Scores = dict[tuple[str, str], dict[tuple[str, int], float]]


def scores(study: str) -> Scores:
    """Mean test PSNR in dB of every run: method -> (scene and its options, seed) -> value."""
    table: Scores = defaultdict(dict)
    for line in (COMMITTED / study / "runs.jsonl").read_text("utf-8").splitlines():
        record = json.loads(line)["record"]
        config = record["config"]
        views = [word for word in record["overrides"] if word.startswith("scene.n_views=")]
        scene = " ".join([record["scene"]["name"], *views])
        value = record["summary"]["psnr"]["mean"]
        table[method(config)][scene, config["seed"]] = value
    return table


def method(config: dict[str, dict[str, object]]) -> tuple[str, str]:
    """The pair of augmenter and regularizer of a configuration, named variants included."""
    reg = config["reg"]
    name = str(reg["name"])
    if name == "uar" and reg.get("mode") == "hard":
        name = "uar_hard"
    if reg.get("compensate"):
        name = {"uniform": "dropgaussian"}.get(name, f"{name}, compensated")
    return str(config["augment"]["name"]), name


def interval(values: Iterable[float], comparisons: int) -> tuple[float, float, float]:
    """Mean and its 95 % interval (Student's t), Bonferroni-corrected."""
    array = np.array(list(values))
    mean, n = float(array.mean()), len(array)
    quantile = stats.t.ppf(1 - 0.05 / 2 / comparisons, n - 1)
    half = float(quantile * array.std(ddof=1) / math.sqrt(n))
    return mean, mean - half, mean + half


def bar(panel: Axes, place: float, values: Iterable[float], comparisons: int, name: str) -> None:
    """Draw a mean and its interval; the mark is filled if the interval excludes zero."""
    mean, low, high = interval(values, comparisons)
    colour = GREEN if name in OURS else GREY
    panel.plot([low, high], [place, place], color=colour, linewidth=2)
    filled = colour if low > 0 or high < 0 else "white"
    panel.plot(mean, place, "o", color=colour, markerfacecolor=filled, markersize=7)


def dress(panel: Axes, names: Iterable[str]) -> None:
    """Labels and lines that all difference charts have."""
    panel.axvline(0, color="black", linewidth=1)
    panel.set_xlabel("difference to the baseline, PSNR (dB)")
    panel.grid(axis="x", alpha=0.3)
    labels = list(names)
    panel.set_yticks(range(len(labels)), labels)
    panel.invert_yaxis()


def draw_paper(out: Path) -> None:
    """Gain of each method under the paper's settings, a panel for each scene."""
    figure = Figure(figsize=(9, 3.6), layout="constrained")
    panels = figure.subplots(1, 2, sharey=True)
    shown = {"fern": ("paper_fern", "llff_fern"), "scan 65": ("paper", "dtu_scan65")}
    for panel, (title, (study, scene)) in zip(panels, shown.items(), strict=True):
        table = {
            pair: {run: value for run, value in values.items() if run[0].split()[0] == scene}
            for pair, values in scores(study).items()
        }
        for place, (pair, name) in enumerate(METHODS.items()):
            if pair in table:
                bar(panel, place, paired(table, pair).values(), len(METHODS), name)
        panel.set_title(title)
        panel.axvline(0, color="black", linewidth=1)
        panel.set_xlabel("difference to the baseline, PSNR (dB)")
        panel.grid(axis="x", alpha=0.3)
    panels[0].set_yticks(range(len(METHODS)), list(METHODS.values()))
    panels[0].invert_yaxis()
    figure.savefig(out, dpi=100)


def paired(table: Scores, pair: tuple[str, str]) -> dict[tuple[str, int], float]:
    """Differences to the baseline with the same scene and seed, in dB."""
    base = table[BASELINE]
    return {key: value - base[key] for key, value in table[pair].items() if key in base}


def draw_found(out: Path) -> None:
    """Difference to the baseline by scene, with `preset=best`."""
    table = scores("best_methods5")
    figure = Figure(figsize=(9, 4.2), layout="constrained")
    panels = figure.subplots(1, 2, sharey=True, sharex=True)
    scenes = sorted({scene for scene, _ in table[BASELINE]})
    labels = [*map(scene_label, scenes), "mean"]
    for panel, pair in zip(panels, (("safi", "uar"), ("none", "dropgaussian")), strict=True):
        differences = paired(table, pair)
        for place, scene in enumerate(scenes):
            values = [value for (of, _), value in differences.items() if of == scene]
            bar(panel, place, values, 1, METHODS[pair])
        seeds = sorted({seed for _, seed in differences})
        means = [np.mean([v for (_, s), v in differences.items() if s == seed]) for seed in seeds]
        bar(panel, len(scenes), means, 2, METHODS[pair])
        panel.set_title(METHODS[pair])
    dress(panels[0], labels)
    panels[1].axvline(0, color="black", linewidth=1)
    panels[1].set_xlabel("difference to the baseline, PSNR (dB)")
    panels[1].grid(axis="x", alpha=0.3)
    figure.savefig(out, dpi=100)


def scene_label(scene: str) -> str:
    """`nerf_fox scene.n_views=12` -> `fox, 12 photos`."""
    name, _, views = scene.partition(" scene.n_views=")
    short = name.partition("_")[2].replace("scan", "scan ")
    return short if views in ("", "3") else f"{short}, {views} photos"


def draw_speed(out: Path) -> None:
    """PSNR and LPIPS over CPU seconds of the presets, means over the scenes of study `speed`."""
    means = quoted.means("speed").loc[list(PRESETS)]
    figure = Figure(figsize=(9, 3.2), layout="constrained")
    psnr, lpips = figure.subplots(1, 2)
    for panel, metric, label, side in (
        (psnr, "psnr", "PSNR (dB)", -1),
        (lpips, "lpips_01", "LPIPS", 1),
    ):
        panel.plot(means["train_cpu_s"], means[metric], "o-", color=GREEN)
        for method, mean in means.iterrows():
            text = f"{PRESETS[method]}, {round(mean['gaussians'], -3):,.0f} Gaussians"
            place = mean["train_cpu_s"], mean[metric]
            aside = {"xytext": (7, 5 * side), "textcoords": "offset points"}
            panel.annotate(text, place, va="bottom" if side > 0 else "top", fontsize=9, **aside)
        panel.set_xscale("log")
        panel.set_xlim(2, 600)
        panel.set_xticks(ticks := (3, 10, 30, 100, 300), map(str, ticks))
        panel.minorticks_off()
        panel.margins(y=0.2)
        panel.set_xlabel("CPU seconds of training")
        panel.set_ylabel(label)
        panel.grid(alpha=0.3)
    figure.savefig(out, dpi=100)


def draw_size(out: Path) -> None:
    """PSNR and LPIPS over the Gaussians on LLFF with three photos, next to published values."""
    rows = pd.read_csv(ROOT / "benchmarks" / "results" / "published_size.csv")
    over_eight = rows["scene"] == "mean of 8"
    published = rows[~over_eight].groupby("method").mean(numeric_only=True)
    ours = quoted.means("depth", "llff").loc[list(FULL_SIZE)].rename(FULL_SIZE)
    figure = Figure(figsize=(9, 4), layout="constrained")
    panels = figure.subplots(1, 2)
    metrics = {"psnr": "PSNR (dB)", "lpips_01": "LPIPS"}
    # places of names that would overlap others
    crowded = {"best": (-10, 8), "ReDI-GS": (7, 6), "Binocular3DGS": (7, -12)}
    for panel, (metric, label) in zip(panels, metrics.items(), strict=True):
        for points, style, name in (
            (ours.sort_values("gaussians"), {"marker": "o", "color": GREEN}, "fishersplat"),
            (published, {"marker": "s", "color": GREY, "ls": ""}, "published, same four scenes"),
            (
                rows[over_eight].set_index("method"),
                {"marker": "D", "color": GREY, "ls": "", "markerfacecolor": "white"},
                "published, mean of eight scenes",
            ),
        ):
            known = points.dropna(subset=metric)
            panel.plot(known["gaussians"], known[metric], label=name, **style)
            for text, point in known.iterrows():
                place = point["gaussians"], point[metric]
                aside = crowded.get(text, (7, -3))
                panel.annotate(text, place, aside, textcoords="offset points", fontsize=8)
        panel.set_xlabel("Gaussians")
        panel.set_ylabel(label)
        panel.set_xlim(0, 140_000)
        panel.xaxis.set_major_locator(MultipleLocator(40_000))
        panel.xaxis.set_major_formatter("{x:,.0f}")
        panel.margins(y=0.12)
        panel.grid(alpha=0.3)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    figure.savefig(out, dpi=100)


def draw_before_after(out: Path) -> None:
    """PSNR and LPIPS over CPU seconds at two commits (benchmarks/results/before_after.md)."""
    text = (ROOT / "benchmarks" / "results" / "before_after.md").read_text("utf-8")
    figure = Figure(figsize=(9, 6), layout="constrained")
    panels = figure.subplots(2, 2, sharex=True)
    for row, part in zip(panels, text.split("\n## ")[1:3], strict=True):
        cells = [line.strip("| ").split(" | ") for line in part.splitlines() if " | ." in line]
        for panel, column, label in zip(row, (2, 4), ("PSNR (dB)", "LPIPS"), strict=True):
            for commit, colour in {"ba2bb7b": GREY, "6c069b2d": GREEN}.items():
                rows = [cell for cell in cells if cell[1] == commit]
                x, y = ([float(cell[k]) for cell in rows] for k in (5, column))
                panel.plot(x, y, "o-", color=colour, label=commit)
            panel.set_xscale("log")
            panel.set_title(part.splitlines()[0], fontsize=10)
            panel.set_ylabel(label)
            panel.grid(alpha=0.3)
    panels[1, 0].plot([436], [20.50], "s", color="black", label="OpenSplat 1.2.0")
    for panel in panels[1]:
        panel.set_xticks(ticks := (1, 3, 10, 30, 100, 300), map(str, ticks))
        panel.minorticks_off()
        panel.set_xlabel("CPU seconds of training")
    panels[0, 0].legend(loc="lower right")
    panels[1, 0].legend(loc="center right")
    figure.savefig(out, dpi=100)


def draw_plugin(out: Path) -> None:
    """A plugin and what the command line makes of it, as text."""
    figure = Figure(figsize=(10.5, 2.6))
    for left, title, text in ((0.01, "mine/small.py", PLUGIN), (0.5, "", HELP)):
        style = {"family": "monospace", "fontsize": 9, "va": "top", "linespacing": 1.4}
        figure.text(left, 0.97, title, weight="bold", **style)
        figure.text(left, 0.88 if title else 0.97, text, **style)
    figure.savefig(out, dpi=100)


def animate(run: Path, video: Path, out: Path) -> None:
    """The three training photos of a run next to its video."""
    photos = sorted((run / "photos").iterdir())[:3]
    with Image.open(video) as film:
        width = round(film.width * film.height / 3 / film.height)
        frames = []
        for number in range(getattr(film, "n_frames", 1)):
            film.seek(number)
            frame = Image.new("RGB", (width + 4 + film.width, film.height), "white")
            for row, photo in enumerate(photos):
                small = Image.open(photo).convert("RGB").resize((width, film.height // 3 - 3))
                frame.paste(small, (0, row * film.height // 3 + 2))
            frame.paste(film.convert("RGB"), (width + 4, 0))
            frames.append(frame)
    options = {"save_all": True, "append_images": frames[1:], "duration": 100, "loop": 0}
    frames[0].save(out, quality=70, method=6, **options)


if __name__ == "__main__":
    draw_paper(IMAGES / "paper.png")
    draw_found(IMAGES / "found.png")
    draw_speed(IMAGES / "speed.png")
    draw_size(IMAGES / "published_size.png")
    draw_before_after(IMAGES / "before_after.png")
    draw_plugin(IMAGES / "plugin.png")
    if len(sys.argv) == 3:
        animate(Path(sys.argv[1]), Path(sys.argv[2]), IMAGES / "flight.webp")
