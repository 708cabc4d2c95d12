"""Does it depend on the photos that one has whether a method helps? Over draws of training photos.

    python benchmarks/quality/draws.py STUDY

STUDY is the folder of a study with its runs over `scene.split=NAME_drawn0,NAME_drawn1,...`, made
from this folder, as the scenes' cameras are read again. Printed are, for each method: what it gains
on each scene; how far its gain differs between draws of a scene and between scenes; and Spearman's
correlation, over draws within scenes (each scene's means taken off) and over scenes, of the gain
with what the draws differ in: how good plain training is, how far the training cameras stand apart,
and how far the test cameras from the nearest of them, both as shares of the mean over the draws of
the scene. p is of permutations within scenes. Plain training's own luck is in its PSNR and in the
gain, which makes the first correlation a little too negative.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy import stats

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from framework.scenes import load_scene

PLAIN = "none+none"
FEATURES = ("plain", "apart", "reach")
SHUFFLES = 20_000


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("study", type=Path, metavar="STUDY")
    rows = table(parser.parse_args().study)
    for method in sorted({*rows["method"]} - {PLAIN}):
        told(method, gains(rows, method))


def table(study: Path) -> pd.DataFrame:
    """A row per run: scene, draw, method, PSNR and what is known of the draw's cameras."""
    known: dict[str, dict[str, float]] = {}
    rows = []
    for path in sorted(study.glob("runs/*/record.json")):
        told = json.loads(path.read_text(encoding="utf-8"))
        config, scene = told["config"], told["scene"]
        if scene["fingerprint"] not in known:
            known[scene["fingerprint"]] = distances(config["scene"])
        reg, own = config["reg"]["name"], config["reg"].get("compensate")
        method = f"{config['augment']['name']}+{'dropgaussian' if own else reg}"
        where = {"scene": scene["name"], "draw": scene["protocol"], "seed": told["seed"]}
        psnr = told["summary"]["psnr"]["mean"]
        rows.append({**where, "method": method, "psnr": psnr, **known[scene["fingerprint"]]})
    return pd.DataFrame(rows)


def distances(options: dict[str, Any]) -> dict[str, float]:
    """Mean distance between the training cameras, and of test cameras to the nearest of them."""
    scene = load_scene(options["name"], {k: v for k, v in options.items() if k != "name"})
    train, test = (
        np.stack([np.linalg.inv(view.camera.viewmat.numpy())[:3, 3] for view in views])
        for views in (scene.training.views, scene.test)
    )
    pairs = np.linalg.norm(train[:, None] - train, axis=2)[np.triu_indices(len(train), 1)]
    near = np.linalg.norm(test[:, None] - train, axis=2).min(axis=1)
    return {"apart": float(pairs.mean()), "reach": float(near.mean())}


def gains(rows: pd.DataFrame, method: str) -> pd.DataFrame:
    """A row per scene and draw: the gain over plain training and the features."""
    keys = ["scene", "draw"]
    psnr = rows.pivot_table(index=[*keys, "seed"], columns="method", values="psnr")
    found = (psnr[method] - psnr[PLAIN]).groupby(keys).mean().rename("gain").to_frame()
    found["plain"] = psnr[PLAIN].groupby(keys).mean()
    found = found.join(rows.groupby(keys)[["apart", "reach"]].first()).dropna().reset_index()
    for name in ("apart", "reach"):
        found[name] /= found.groupby("scene")[name].transform("mean")
    return found


def told(method: str, found: pd.DataFrame) -> None:
    by_scene = found.groupby("scene")
    means = by_scene["gain"].mean()
    half = stats.t.ppf(0.975, len(means) - 1) * means.std() / np.sqrt(len(means))
    inside = np.sqrt(by_scene["gain"].var().mean())
    low, high = means.mean() - half, means.mean() + half
    print(
        f"\n{method}: {means.mean():+.3f} dB ({low:.3f} to {high:.3f}, {len(means)} scenes); sigma"
        f" between draws of a scene {inside:.2f}, between means of scenes {means.std():.2f}"
    )
    for scene, own in by_scene:
        listed = ", ".join(f"{gain:+.2f}" for gain in own["gain"])
        print(f"  {scene}: {own['gain'].mean():+.2f} ({listed}), plain {own['plain'].mean():.2f}")
    for name in FEATURES:
        print(f"  with {name}, within scenes: {within(found, name)}")
    over = stats.spearmanr(by_scene["plain"].mean(), means)
    print(f"  with plain, over scenes: {over.statistic:.2f} (p = {over.pvalue:.2g})")


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
