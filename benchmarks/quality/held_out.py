"""Compare settings on views that are neither trained on nor tested on: how defaults are chosen.

    python benchmarks/quality/held_out.py --scene "scene=embedded" \\
        --scene "scene=llff scene.path=DIR scene.n_views=3 held_out=9" \\
        --setting "trainer.steps=300" --setting "trainer.steps=300 trainer.lr_scales=0.005"

A scene's held-out views are training views of its larger split (`held_out` views) that the smaller
one leaves out, so a choice made here has seen no test view. The embedded scene, made for this, is
judged on its test views. Every setting trains once per scene and seed on one thread; seconds are
CPU time of the training. Prints a markdown table, or writes it to the file of `--output`.
"""

from __future__ import annotations

import argparse
import re
import statistics
import sys
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks.prepare import Prepared, configured, prepared
from framework import registry
from framework.compute import parallel
from framework.metrics.evaluate import psnr
from framework.metrics.values import Missing
from framework.options import TrainerOptions
from framework.records.provenance import cpu_model
from framework.run.training import renderer
from framework.types import View

MOST_VIEWS = 6  # to judge by, evenly spread over those held out


@dataclass(frozen=True)
class Result:
    """psnr, worst: mean over and least of the held-out views, in dB. cpu_s: of the training."""

    psnr: float
    worst: float
    cpu_s: float
    gaussians: int


def held_out_views(overrides: list[str], count: int | None) -> tuple[View, ...]:
    """Without a count the test views, of the embedded scene alone."""
    options = configured(overrides)["scene"]
    chosen = registry.part("scene", options).load()
    if count is None:
        if (name := options["name"]) != "embedded":
            raise SystemExit(
                f"--scene {name}: expected held_out=N, got none; test views may not choose"
            )
        return chosen.test
    used = {view.name for view in chosen.training.views}
    larger = registry.part("scene", {**options, "n_views": count}).load().training.views
    others = [view for view in larger if view.name not in used]
    return tuple(others[:: max(1, len(others) // MOST_VIEWS)][:MOST_VIEWS])


def measure(run: Prepared, views: tuple[View, ...]) -> Result:
    """Train once and judge."""
    trained = run.trained()
    options, near = TrainerOptions(**run.config["trainer"]), run.scene.training.near
    render = renderer(
        trained.gaussians, trained.background, trained.sh_degree, options.near_plane * near
    )
    values = [psnr(render(view.camera), view.image, view.mask) for view in views]
    finite = [value for value in values if not isinstance(value, Missing)]
    return Result(statistics.fmean(finite), min(finite), trained.cpu_s, len(trained.gaussians))


def row(setting: str, results: list[Result]) -> str:
    """Mean over the scenes last: what a setting is chosen by."""
    cells = [f"{r.psnr:.2f} ({r.worst:.2f}), {r.gaussians}, {r.cpu_s:.0f} s" for r in results]
    mean = statistics.fmean(r.psnr for r in results)
    return f"| `{setting or 'defaults'}` | " + " | ".join([*cells, f"**{mean:.2f}**"]) + " |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scene", action="append", required=True)
    parser.add_argument("--setting", action="append", required=True)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--output", type=Path)
    given = parser.parse_args()
    parallel.set_threads(1)
    scenes = []
    for text in given.scene:
        words = text.split()
        counts = [int(w.split("=")[1]) for w in words if w.startswith("held_out=")]
        overrides = [w for w in words if not w.startswith("held_out=")]
        scenes.append((overrides, held_out_views(overrides, counts[0] if counts else None)))
    told = [re.sub(r"path=\S+", "path=DIR", text) for text in given.scene]
    asked = " ".join([*(f'--scene "{text}"' for text in told), f"--seed {given.seed}"])
    names = [" ".join(w for w in o if "path" not in w) for o, _ in scenes]
    lines = [
        "# Settings on held-out training views",
        "",
        f"`python benchmarks/quality/held_out.py {asked}`, with the settings below as"
        f" `--setting`, on {cpu_model()}: PSNR in dB, in brackets of the worst view,"
        " Gaussians, and CPU seconds of the training.",
        "",
        "| setting | " + " | ".join(names) + " | mean |",
        "|---|" + "---|" * (len(names) + 1),
    ]
    print("\n".join(lines), flush=True)
    for setting in given.setting:
        runs = [(prepared([*o, *setting.split(), f"seed={given.seed}"]), v) for o, v in scenes]
        lines.append(row(setting, [measure(run, views) for run, views in runs]))
        print(lines[-1], flush=True)
    if given.output:
        given.output.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
