"""Finished runs with dropout, evaluated as dim as they were trained: `reg.scale_tested` afterwards.

    python benchmarks/quality/as_dim.py STUDY... [--table CSV] [--beside RUNS_CSV]

STUDY: folders of studies with their runs of `reg=uar`, `uar_hard` or `uniform` that drop without
compensation to the last step (`preset=paper`), made from this folder, as scenes are read again; or
the table that --table wrote. The option changes nothing in a training, so each run gives both: what
was evaluated, which has to be what its record says, and the same Gaussians with opacities times
their expected factors in the last step. UAR ranks anew for it, where a run with the option has a
ranking of up to `reg.refresh` steps before. Printed are the means over seeds of both, and of their
differences with 95 % (t over seeds, each alone, and corrected for all rows), and methods against
each other with the same seeds, both as dim and both as they were. --table: a row per run. --beside:
a report's table of other methods under the same conditions, to which each is compared as dim.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from itertools import combinations, product
from pathlib import Path
from typing import Any

import pandas as pd

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from framework import registry
from framework.methods.dropout import DropoutRegularizer
from framework.metrics.evaluate import evaluate
from framework.metrics.lpips import load
from framework.metrics.lpips_weights import chosen
from framework.options import TrainerOptions
from framework.records.ply import read_ply
from framework.records.record import PLY
from framework.report.statistics.estimates import estimate
from framework.report.study.collect import collect
from framework.report.study.runs import ReportRun
from framework.run.training import renderer
from framework.train.context import Conditions, Moment, step_context
from framework.types import Gaussians

NOTED = ("psnr", "ssim", "lpips", "lpips_01")
SAME = 1e-6  # dB


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("studies", type=Path, nargs="+", metavar="STUDY")
    parser.add_argument("--table", type=Path, metavar="CSV", help="write a row per run")
    parser.add_argument("--beside", type=Path, metavar="CSV", help="other methods, as runs.csv")
    given = parser.parse_args()
    table = pd.concat([_table(study) for study in given.studies])
    if table.empty:
        raise SystemExit("expected runs whose dropout goes on to the end, got none")
    if given.table:
        table.round(4).to_csv(given.table, index=False, lineterminator="\n")
    groups = table.groupby(["scene", "method"], sort=False)
    for (scene, method), own in groups:
        gains = own.dim_psnr - own.psnr
        print(
            f"{scene}, {method}, n = {len(own)}: {own.psnr.mean():.2f} ± {own.psnr.std():.2f} dB,"
            f" as dim as trained {own.dim_psnr.mean():.2f} ± {own.dim_psnr.std():.2f}:"
            f" {told(gains)}, corrected {told(gains, len(groups))}; LPIPS"
            f" {own.lpips.mean():.3f} and {own.dim_lpips.mean():.3f}"
        )
    others = None if given.beside is None else pd.read_csv(given.beside, low_memory=False)
    for scene, own in table.groupby("scene", sort=False):
        by_seed = own.pivot(index="seed", columns="method")
        for one, other in combinations(own.method.unique(), 2):
            dim, full = (by_seed[k][one] - by_seed[k][other] for k in ("dim_psnr", "psnr"))
            print(f"{scene}, {one} - {other}: as dim {told(dim)}, at full opacity {told(full)}")
        if others is not None:
            there = others[others.scene == scene].pivot(
                index="seed", columns="method", values="psnr"
            )
            for one, other in product(own.method.unique(), there):
                gains = by_seed["dim_psnr"][one] - there[other]
                print(f"{scene}, {one} as dim - {other}: {told(gains)}")


def told(gains: pd.Series, tests: int = 1) -> str:
    """Mean and 95 % over the seeds that both have."""
    gain = estimate(list(gains.dropna()))
    inside = gain.interval(tests)
    interval = "" if inside is None else f" ({inside.low:+.2f} to {inside.high:+.2f})"
    return f"{gain.mean:+.2f}{interval}"


def _table(study: Path) -> pd.DataFrame:
    if study.is_file():
        return pd.read_csv(study)
    return pd.DataFrame([row for run in collect(study).runs for row in measured(run)])


def measured(run: ReportRun) -> list[dict[str, Any]]:
    """A row of a run with both evaluations, or none where there is nothing to compare."""
    config = run.record.config
    plugged = registry.build("reg", config["reg"])
    plugin = plugged.plugin
    fits = isinstance(plugin, DropoutRegularizer) and not plugin.compensate
    if not fits or plugin.scale_tested or plugged.stop < 1:
        return []
    gaussians, background = read_ply(run.run.run_dir / PLY)
    assert background is not None
    options = TrainerOptions(**config["trainer"])
    scene = registry.part("scene", config["scene"]).load()
    near = options.near_plane * scene.training.near
    conditions = Conditions(scene.training, (), options, background, near, run.seed)
    last = Moment(options.steps - 1, 0, 0, gaussians, gaussians.sh_degree)
    context = step_context(conditions, last, "reg", lambda name, value: None)
    dim = replace(plugin, scale_tested=True).evaluated(context, gaussians, None)
    weights = chosen(config["metrics"]["lpips_weights"])
    network = None if weights is None else load(weights)

    def means(of: Gaussians) -> dict[str, float]:
        render = renderer(of, background, of.sh_degree, near)
        views, _ = evaluate(render, scene.test, network)
        values = {name: [view.value(name) for view in views] for name in NOTED}
        return {
            n: sum(v) / len(v) if all(isinstance(x, float) for x in v) else float("nan")
            for n, v in values.items()
        }

    row = means(gaussians)
    kept = run.mean("psnr")
    assert kept is not None and abs(row["psnr"] - kept) < SAME, (run.run.run_dir, row["psnr"], kept)
    more = {f"dim_{name}": value for name, value in means(dim).items()}
    return [{"scene": run.scene, "method": run.method, "seed": run.seed, **row, **more}]


if __name__ == "__main__":
    main()
