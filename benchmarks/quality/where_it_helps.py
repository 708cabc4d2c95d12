"""Does a method help where plain training is worst? View by view, over the runs of a study.

    python benchmarks/quality/where_it_helps.py STUDY|RUNS_CSV [--against none+none] [--first 2]

STUDY is the folder of a study with its runs, of which `metrics.csv` has a row per test view. How
good plain training is at a view is its mean PSNR over the lowest --first seeds; what a method gains
there is the mean difference of PSNR over the other seeds, so that a seed's luck at a view is not in
both. Printed are Spearman's correlation of the two over scenes, over views within scenes (each
scene's means taken off) and in each scene, and the gain by how good plain training is.

RUNS_CSV is the table of a report, which has no views: printed is the correlation over scenes for
every choice of --first seeds that say how good plain training is.
"""

from __future__ import annotations

import argparse
import json
from itertools import combinations
from pathlib import Path

import pandas as pd
from scipy.stats import spearmanr

BOUNDS = (0, 22, 26, 100)  # dB


def views(study: Path) -> pd.DataFrame:
    """A row per scene, view, seed; a column of PSNR per method."""
    parts = []
    for record in sorted(study.glob("runs/*/record.json")):
        told = json.loads(record.read_text(encoding="utf-8"))
        config = told["config"]
        table = pd.read_csv(record.parent / "metrics.csv")[["view", "psnr"]]
        method = f"{config['augment']['name']}+{config['reg']['name']}"
        scene = told["scene"]["name"]
        parts.append(table.assign(method=method, scene=scene, seed=config["seed"]))
    rows = pd.concat(parts)
    return rows.pivot_table(
        index=["scene", "view", "seed"], columns="method", values="psnr"
    ).reset_index()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("study", type=Path, metavar="STUDY")
    parser.add_argument("--against", default="none+none", help="the plain method")
    parser.add_argument("--first", type=int, default=2, help="seeds that say how good it is")
    options = parser.parse_args()
    if options.study.is_file():
        every_split(options.study, options.against, options.first)
        return
    table = views(options.study)
    seeds = sorted(table["seed"].unique())
    early, late = (
        table[table["seed"].isin(s)] for s in (seeds[: options.first], seeds[options.first :])
    )
    level = early.groupby(["scene", "view"])[options.against].mean()
    for method in table.columns.drop(["scene", "view", "seed", options.against]):
        gain = (late[method] - late[options.against]).groupby([late["scene"], late["view"]]).mean()
        both = pd.DataFrame({"level": level, "gain": gain}).reset_index().dropna()
        told(method, both)


def every_split(runs: Path, against: str, first: int) -> None:
    rows = pd.read_csv(runs, low_memory=False)
    rows["method"] = rows["method"].str.replace(" ", "")
    psnr = rows.pivot(index=["scene", "seed"], columns="method", values="psnr").reset_index()
    for method in psnr.columns.drop(["scene", "seed", against]):
        print(f"\n{method}, {psnr.scene.nunique()} scenes, rank correlation with plain PSNR:")
        for early in combinations(sorted(psnr.seed.unique()), first):
            said, late = psnr[psnr.seed.isin(early)], psnr[~psnr.seed.isin(early)]
            gain = (late[method] - late[against]).groupby(late.scene).mean()
            both = pd.DataFrame({"level": said.groupby("scene")[against].mean(), "gain": gain})
            print(f"  plain by seeds {' and '.join(map(str, early))}: {_rank(both)}")


def told(method: str, both: pd.DataFrame) -> None:
    scenes = both.groupby("scene")[["level", "gain"]].mean()
    inside = both[["level", "gain"]] - both.groupby("scene")[["level", "gain"]].transform("mean")
    print(
        f"\n{method}, {len(both)} views of {len(scenes)} scenes, rank correlation with plain PSNR:"
    )
    for what, rows in (("over scenes", scenes), ("over views within scenes", inside)):
        print(f"  {what}: {_rank(rows)}")
    for scene, rows in both.groupby("scene"):
        print(f"    {scene}, {len(rows)} views: {_rank(rows)}")
    for bounds, rows in both.groupby(pd.cut(both["level"], BOUNDS), observed=True):
        print(f"  plain in {bounds} dB: {rows['gain'].mean():+.2f} dB, {len(rows)} views")


def _rank(rows: pd.DataFrame) -> str:
    if len(rows) < 3:
        return "too few"
    found = spearmanr(rows["level"], rows["gain"])
    return f"{found.statistic:.2f} (p = {found.pvalue:.1g})"


if __name__ == "__main__":
    main()
