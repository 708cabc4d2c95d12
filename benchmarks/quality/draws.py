"""Does it depend on the photos that one has whether a method helps? Over draws of training photos.

    python benchmarks/quality/draws.py STUDY [--table CSV] [--usual RUNS_CSV --chart PNG]

STUDY is the folder of a study with its runs over `scene.split=NAME_drawn0,NAME_drawn1,...`, made
from this folder, as the scenes' cameras are read again. Printed are, for each method: what it gains
on each scene; how far its gain differs between draws of a scene and between scenes; and Spearman's
correlation, over draws within scenes (each scene's means taken off) and over scenes, of the gain
with what the draws differ in: how good plain training is, how far the training cameras stand apart,
and how far the test cameras from the nearest of them, both as shares of the mean over the draws of
the scene. p is of permutations within scenes. Of draws with several seeds the intervals over seeds
and an analysis of variance are printed too. Plain training's own luck is in its PSNR and in the
gain, which makes the first correlation a little too negative. --table: a row per run. --chart: the
gains of SAFI + UAR by scene, beside those of the papers' photos from a report's table, --usual.
"""

from __future__ import annotations

import argparse
import sys
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from scipy import stats

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from framework import registry
from framework.report.statistics.drawn import Draws, draws
from framework.report.statistics.estimates import estimate
from framework.report.study.collect import collect
from framework.report.study.order import BASELINE
from framework.report.study.runs import Study

BOTH = "safi + uar"
FEATURES = ("plain", "apart", "reach")
SHUFFLES = 20_000


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("study", type=Path, metavar="STUDY")
    parser.add_argument("--table", type=Path, metavar="CSV", help="write a row per run")
    parser.add_argument(
        "--usual", type=Path, metavar="CSV", help="runs.csv with the papers' photos"
    )
    parser.add_argument("--chart", type=Path, metavar="PNG", help="draw the gains of SAFI + UAR")
    given = parser.parse_args()
    study = collect(given.study)
    rows, by_method = table(study), defaultdict(list)
    for own in draws(study):
        by_method[own.method].append(own)
    if given.table:
        order = ["scene", "draw", "seed", "method"]
        rows.sort_values(order).round(4).to_csv(given.table, index=False, lineterminator="\n")
    if given.chart:
        chart(gains(rows, by_method[BOTH]), usual(given.usual)).savefig(given.chart, dpi=110)
    for own in by_method.values():
        found = gains(rows, own)
        told(found, own)
    shape = found["scene"].nunique(), int(found.groupby("scene").size().median())
    for rho, share in power(*shape).items():
        print(f"a correlation of {rho} within scenes is found {share:.0%} of the time")


def table(study: Study) -> pd.DataFrame:
    """A row per run: scene, draw, method, PSNR and what is known of the draw's cameras."""
    known: dict[str, dict[str, float]] = {}
    rows = []
    for run in study.runs:
        scene, psnr = run.record.scene, run.mean("psnr")
        if scene is None or psnr is None:
            continue
        if scene.fingerprint not in known:
            known[scene.fingerprint] = distances(run.record.config["scene"])
        where = {"scene": scene.name, "draw": scene.protocol, "seed": run.seed}
        rows.append({**where, "method": run.method, "psnr": psnr, **known[scene.fingerprint]})
    return pd.DataFrame(rows)


def distances(options: dict[str, Any]) -> dict[str, float]:
    """Mean distance between the training cameras, and of test cameras to the nearest of them."""
    scene = registry.part("scene", options).load()
    train, test = (
        np.stack([np.linalg.inv(view.camera.viewmat.numpy())[:3, 3] for view in views])
        for views in (scene.training.views, scene.test)
    )
    pairs = np.linalg.norm(train[:, None] - train, axis=2)[np.triu_indices(len(train), 1)]
    near = np.linalg.norm(test[:, None] - train, axis=2).min(axis=1)
    return {"apart": float(pairs.mean()), "reach": float(near.mean())}


def gains(rows: pd.DataFrame, own: Sequence[Draws]) -> pd.DataFrame:
    """A row per scene and draw: the gain over plain training and the features."""
    found = pd.DataFrame(
        {"scene": d.scene, "draw": draw, "gain": gain, "plain": d.plain[draw]}
        for d in own
        for draw, gain in zip(d.differences, d.gains, strict=True)
    )
    keys = ["scene", "draw"]
    features = rows.groupby(keys)[["apart", "reach"]].first()
    found = found.join(features, on=keys).dropna().reset_index(drop=True)
    for name in ("apart", "reach"):
        found[name] /= found.groupby("scene")[name].transform("mean")
    return found


def usual(path: Path | None) -> dict[str, float]:
    """What SAFI + UAR gain in the mean by scene of a report's table."""
    if path is None:
        return {}
    psnr = pd.read_csv(path).pivot_table(index=["scene", "seed"], columns="method", values="psnr")
    return dict((psnr[BOTH] - psnr[BASELINE]).groupby("scene").mean())


def chart(found: pd.DataFrame, papers: dict[str, float]) -> Figure:
    """A row per scene: the gain with each draw, and with the papers' photos."""
    figure = Figure(figsize=(7.2, 3.4), layout="constrained")
    axes = figure.subplots()
    scenes = list(found.groupby("scene")["gain"].mean().sort_values().index)
    rows = found["scene"].map(scenes.index)
    axes.axvline(0, color="0.6", lw=1)
    axes.plot(found["gain"], rows, "o", color="#1f6fb4", label="photos drawn by lot")
    known = [scene for scene in scenes if scene in papers]
    places = [scenes.index(scene) for scene in known]
    axes.plot([papers[s] for s in known], places, "D", mfc="w", mec="k", label="papers' photos")
    axes.set_yticks(range(len(scenes)), [scene.partition("_")[2] for scene in scenes])
    axes.set_xlabel("what SAFI + UAR gain with preset=best, test PSNR in dB")
    axes.legend(loc="lower right")
    return figure


def told(found: pd.DataFrame, own: Sequence[Draws]) -> None:
    """What there is to say of one method."""
    by_scene = found.groupby("scene")
    means = [d.over.mean for d in own]
    inside = np.sqrt(np.mean([np.var(d.gains, ddof=1) for d in own]))
    print(
        f"\n{own[0].method}: {_mean(means)}, {len(means)} scenes; sigma"
        f" between draws of a scene {inside:.2f}, between means of scenes"
        f" {np.std(means, ddof=1):.2f}"
    )
    for d in own:
        listed, plain = ", ".join(f"{gain:+.2f}" for gain in d.gains), np.mean([*d.plain.values()])
        print(f"  {d.scene}: {d.over.mean:+.2f} ({listed}), plain {plain:.2f}")
        if d.alike is not None:
            several = [seeds for seeds in d.differences.values() if len(seeds) > 1]
            print(
                f"    over seeds: {', '.join(map(_mean, several))}; sigma between seeds"
                f" {d.alike.sd:.2f}; draws differ: F = {d.alike.f:.1f}, p = {d.alike.p:.1g}"
            )
    for name in FEATURES:
        print(f"  with {name}, within scenes: {within(found, name)}")
    over = stats.spearmanr(by_scene["plain"].mean(), by_scene["gain"].mean())
    print(f"  with plain, over scenes: {over.statistic:.2f} (p = {over.pvalue:.2g})")


def _mean(values: Sequence[float]) -> str:
    found = estimate(list(values))
    inside = found.interval()
    return f"{found.mean:+.3f}" + (f" ({inside.low:.2f} to {inside.high:.2f})" if inside else "")


def power(scenes: int, draws: int, times: int = 2000) -> dict[float, float]:
    """Correlation within scenes -> how often it is found at 5 %, by simulated normal draws."""
    rng = np.random.default_rng(0)

    def seen(rho: float) -> float:
        x, own = rng.standard_normal((2, scenes, draws))
        y = rho * x + np.sqrt(1 - rho**2) * own
        x, y = (v - v.mean(axis=1, keepdims=True) for v in (x, y))
        return abs(float(stats.spearmanr(x.ravel(), y.ravel()).statistic))

    bound = np.quantile([seen(0.0) for _ in range(times)], 0.95)
    return {rho: float(np.mean([seen(rho) > bound for _ in range(times)])) for rho in (0.4, 0.6)}


def within(found: pd.DataFrame, name: str) -> str:
    both = found[[name, "gain"]] - found.groupby("scene")[[name, "gain"]].transform("mean")
    x, y = both[name].to_numpy(), both["gain"].to_numpy()
    seen = stats.spearmanr(x, y).statistic
    rng, places = np.random.default_rng(0), list(found.groupby("scene").indices.values())
    x, y = stats.rankdata(x), stats.rankdata(y)  # of all, as Spearman's correlation takes them
    beyond = 0
    for _ in range(SHUFFLES):
        order = np.arange(len(y))
        for own in places:
            order[own] = rng.permutation(own)
        beyond += abs(np.corrcoef(x, y[order])[0, 1]) >= abs(seen) - 1e-12
    return f"{seen:.2f} (p = {(beyond + 1) / (SHUFFLES + 1):.2g}, {len(found)} draws)"


if __name__ == "__main__":
    main()
