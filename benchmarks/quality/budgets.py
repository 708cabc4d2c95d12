"""Do more steps, more photos and dearer presets help, and what do they cost?

    python benchmarks/quality/budgets.py --data DIR --studies DIR [--ask time views presets]
        [--seeds 0,1,2] [--steps 100,300,1000,3000,10000] [--presets fast,balanced,best] [--lpips]
        [--run] [--output FILE.md]

DIR of --data holds the scenes of `SCENES` by name. With --run every study is done by `run.py`, one
process and thread, into the folder of --studies; what is complete there is kept, so a second call
goes on, with more seeds if they are given. Means over seeds go to FILE.csv, where what was not
measured again keeps its row and its code; from there come the tables, which replace those of
FILE.md from "## Time" on, and the chart FILE.png. Time and views are asked at half the photos'
size. Seconds are CPU seconds of the training, as other programs disturb them less than the clock;
memory is the peak of the process. --lpips: of the presets' runs LPIPS (VGG) is measured too, by the
weights that `fishersplat fetch lpips` fetched.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np
import pandas as pd

from benchmarks.quality.budgets_chart import FORWARD, chart
from framework.report.study.roles import CHOSE, role

ROOT = Path(__file__).resolve().parents[2]
PRESETS = ("fast", "balanced", "best", "long")
STEPS = {"fast": 75, "balanced": 600, "best": 2400, "long": 12000}  # conf/preset
TOLERANCE_DB = 0.1  # by which a longer training may be below a shorter one
KEY = ["ask", "scene", "views", "of"]
NUMBERS = ["train_cpu_s", "gaussians", "parameters"]  # means over the seeds


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


def measured(studies: Path) -> pd.DataFrame:
    """A row for every question, scene, number of views and length or preset ("of"), over its seeds:
    psnr and sd in dB, lpips_01, the most memory in MB, seeds, code, and means of `NUMBERS`."""
    rows: list[dict[str, object]] = []
    names = [
        (ask, scene, str(place.views))
        for ask in ("time", "presets")
        for scene, place in SCENES.items()
    ]
    names += [("views", name, "") for name in VIEWS]
    for ask, name, usual in names:
        table = runs(studies, f"{ask}_{name}")
        if not len(table):
            continue
        table["views"] = usual or table["overrides"].str.extract(r"scene\.n_views=(\S+)")[0]
        option = r"trainer\.steps=(\d+)" if ask == "time" else r"preset=(\w+)"
        table["of"] = table["overrides"].str.extract(option)[0]
        for (views, of), g in table.groupby(["views", "of"], sort=False):
            row = {"ask": ask, "scene": name, "views": views, "of": of, "psnr": g["psnr"].mean()}
            row |= {"sd": g["psnr"].std(), "lpips_01": g["lpips_01"].mean()}
            row |= {column: g[column].mean() for column in NUMBERS}
            row |= {"memory_mb": g["memory_mb"].max(), "seeds": g["seed"].nunique()}
            rows.append({**row, "code": " ".join(sorted(set(g["code"].astype(str))))})
    return pd.DataFrame(rows)


def runs(studies: Path, study: str) -> pd.DataFrame:
    """The complete runs of a study, an empty table where there is none."""
    file = studies / study / "runs.csv"
    if not file.exists():
        return pd.DataFrame()
    table = pd.read_csv(file)
    folder = studies / study / "runs"
    table["memory_mb"] = [memory_mb(folder / str(run) / "record.json") for run in table["run"]]
    return table.dropna(subset=["psnr"])


def memory_mb(record: Path) -> float:
    """What the process of a run had at its most."""
    return json.loads(record.read_text())["peak_memory_bytes"] / 1e6 if record.exists() else np.nan


def kept(new: pd.DataFrame, file: Path) -> pd.DataFrame:
    """The rows of before that were not measured again, and the new ones, in one order; written to
    `file`."""
    known = pd.read_csv(file, dtype={"views": str, "of": str}) if file.exists() else new
    both = pd.concat([known, new]).drop_duplicates(KEY, keep="last", ignore_index=True)
    lengths = [*PRESETS, *sorted({of for of in both["of"] if of.isdigit()}, key=int)]
    order = pd.DataFrame(
        {
            "ask": both["ask"].map(list(TABLES).index),
            "scene": both["scene"].map([*SCENES, *VIEWS].index),
            "views": both["views"].replace("all", "999").astype(int),
            "of": both["of"].map(lengths.index),
        }
    )
    both = both.loc[order.sort_values(KEY).index]
    both.round(4).to_csv(file, index=False)
    return both


def told(row: pd.Series, digits: int = 2) -> str:
    """Mean and, of several seeds, their standard deviation."""
    spread = f" ± {row['sd']:.2f}" if row["seeds"] > 1 else ""
    return f"{row['psnr']:.{digits}f}{spread}"


def seeds_of(rows: pd.DataFrame) -> str:
    low, high = int(rows["seeds"].min()), int(rows["seeds"].max())
    return f"{low}" if low == high else f"{low} to {high}"


def time_table(every: pd.DataFrame) -> list[str]:
    asked = every[every["ask"] == "time"]
    counts = sorted(set(asked["of"].astype(int)))
    lines = [
        "| scene, views | "
        + " | ".join(f"{n:,}" for n in counts)
        + " | seeds | Gaussians, MB, of the longest | worst step back, dB |",
        "|---|" + "---:|" * (len(counts) + 3),
    ]
    for scene, rows in asked.groupby("scene", sort=False):
        by = {int(row["of"]): row for _, row in rows.iterrows()}
        cells = [f"{told(by[n])}, {by[n]['train_cpu_s']:.0f} s" if n in by else "-" for n in counts]
        means = [by[n]["psnr"] for n in counts if n in by]
        back = min((b - a for i, a in enumerate(means) for b in means[i + 1 :]), default=0.0)
        shown = f"{back:.2f}" if back < -TOLERANCE_DB else "none"
        longest = by[max(by)]
        size = f"{longest['gaussians']:,.0f}, {longest['memory_mb']:,.0f}"
        name = f"{SCENES[scene].bold(scene)}, {SCENES[scene].views}"
        lines.append(f"| {name} | {' | '.join(cells)} | {seeds_of(rows)} | {size} | {shown} |")
    return lines


def views_table(every: pd.DataFrame) -> list[str]:
    lines = [
        "| scene, views | " + " | ".join(PRESETS[:3]) + " | seeds |",
        "|---|---:|---:|---:|---:|",
    ]
    asked = every[every["ask"] == "views"]
    for (name, views), rows in asked.groupby(["scene", "views"], sort=False):
        by = {row["of"]: row for _, row in rows.iterrows()}
        cells = [
            f"{told(by[p])}, {by[p]['train_cpu_s']:.0f} s" if p in by else "-" for p in PRESETS[:3]
        ]
        bold = SCENES[VIEWS[name][0]].bold(name)
        lines.append(f"| {bold}, {views} | {' | '.join(cells)} | {seeds_of(rows)} |")
    return lines


def presets_table(every: pd.DataFrame) -> list[str]:
    asked = every[every["ask"] == "presets"]
    have = [p for p in PRESETS if p in set(asked["of"])]
    lines = [
        "| scene, views | "
        + " | ".join(f"`{p}` ({STEPS[p]:,} steps)" for p in have)
        + " | seeds | MB |",
        "|---|" + "---|" * len(have) + "---:|---:|",
    ]
    for scene, rows in asked.groupby("scene", sort=False):
        by = {row["of"]: row for _, row in rows.iterrows()}
        cells = [
            f"{told(by[p])} dB, {sharpness(by[p])}{costs(by[p])}" if p in by else "-" for p in have
        ]
        size = f"{seeds_of(rows)} | {rows['memory_mb'].max():,.0f}"
        name = f"{SCENES[scene].bold(scene)}, {SCENES[scene].views}"
        lines.append(f"| {name} | {' | '.join(cells)} | {size} |")
    for what, scenes in (("ten scenes", tuple(SCENES)), (", ".join(FORWARD), FORWARD)):
        among = asked[asked["scene"].isin(scenes)].groupby("of")
        columns = ["psnr", "lpips_01", *NUMBERS]
        means = {
            p: rows[columns].mean(skipna=False) for p, rows in among if len(rows) == len(scenes)
        }
        cells = [
            f"{means[p]['psnr']:.2f} dB, {sharpness(means[p])}{costs(means[p])}"
            if p in means
            else "-"
            for p in have
        ]
        lines.append(f"| mean of {what} | {' | '.join(cells)} | | |")
    return lines


def costs(row: pd.Series) -> str:
    return f"{row['train_cpu_s']:.0f} s, {row['gaussians']:,.0f}"


def sharpness(row: pd.Series) -> str:
    """LPIPS as papers feed it, images in [0, 1], where it was measured."""
    return f"{row['lpips_01']:.3f}, " if np.isfinite(row["lpips_01"]) else ""


TABLES = {"time": time_table, "views": views_table, "presets": presets_table}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path)
    parser.add_argument("--studies", type=Path, required=True)
    parser.add_argument("--ask", nargs="+", choices=TABLES, default=list(TABLES))
    parser.add_argument("--seeds", default="0,1,2")
    parser.add_argument("--steps", default="100,300,1000,3000,10000")
    parser.add_argument("--presets", default="fast,balanced,best")
    parser.add_argument("--lpips", action="store_true", help="of the presets' runs")
    parser.add_argument("--run", action="store_true")
    parser.add_argument("--output", type=Path)
    given = parser.parse_args()
    if given.run and given.data is None:
        parser.error("--run: expected --data DIR, the folder of the scenes")
    if given.run:
        for ask in given.ask:
            for words in commands(
                ask, given.data, given.seeds, given.steps, given.presets, given.lpips
            ):
                where = f"hydra.sweep.dir={given.studies}"
                command = [sys.executable, str(ROOT / "run.py"), *words[:-1], where, "-m"]
                subprocess.run(command, check=False)  # what failed is told there, and missing here
    found = measured(given.studies)
    if not len(found):
        parser.error(f"--studies {given.studies}: expected studies made with --run, found none")
    if given.output:
        found = kept(found, given.output.with_suffix(".csv"))
    asked = [ask for ask in TABLES if ask in set(found["ask"])]
    text = "".join(
        f"## {ask.capitalize()}\n\n" + "\n".join(TABLES[ask](found)) + "\n\n" for ask in asked
    )
    print(text)
    if given.output:
        old = given.output.read_text(encoding="utf-8") if given.output.exists() else ""
        before = min((old.partition(f"## {ask.capitalize()}\n")[0] for ask in TABLES), key=len)
        given.output.write_text(before + text.rstrip() + "\n", encoding="utf-8")
        points = found[found["ask"] == "presets"].rename(columns={"scene": "place", "of": "preset"})
        picture = given.output.with_suffix(".png")
        if len(points):
            chart(points).savefig(picture, dpi=110, metadata={"Software": None})


if __name__ == "__main__":
    main()
