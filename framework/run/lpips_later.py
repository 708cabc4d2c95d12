"""LPIPS of a complete run that was made before its weights were there, from the images it saved.

Metrics are of what is saved, so the numbers are those that the run would have got; nothing is
trained again for them. A run that has LPIPS keeps it when the weights are gone.
"""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from framework.errors import UserError, require
from framework.files.whole import following, write_whole
from framework.metrics.coadaptation import with_average
from framework.metrics.evaluate import NO_LPIPS, lpips_of, mean_of
from framework.metrics.values import AVERAGE, LPIPS_BOTH, METRICS, Missing, ViewMetrics
from framework.records.record import LPIPS, RunRecord, read_run, write_record
from framework.records.run_files import METRICS_CSV, RENDERS, Table, metrics_csv

if TYPE_CHECKING:
    from framework.metrics.lpips import Lpips


def lacks_lpips(record: RunRecord, network: Lpips | None) -> bool:
    """Whether `network` can measure the LPIPS that `record` lacks because weights were missing."""
    return network is not None and record.summary.get("lpips") == NO_LPIPS


def with_lpips(run_dir: Path, record: RunRecord, network: Lpips | None) -> RunRecord:
    """Add LPIPS to the complete `record` in `run_dir`; the caller holds the run's lock.

    The record is written last, so a process killed before that leaves the old one.

    Raises:
        UserError: where the run's files are missing or damaged.
    """
    if network is None or not lacks_lpips(record, network):
        return record
    table = read_run(run_dir).metrics
    stems, views = table.texts["file"], _views(table, run_dir)
    pairs = [_saved_pair(run_dir / RENDERS, stem) for stem in stems]
    values = lpips_of(pairs, network, record.config["metrics"].get(LPIPS_BOTH, False))
    metrics = [
        dataclasses.replace(view, lpips=lpips, lpips_01=lpips_01)
        for view, lpips, lpips_01 in zip(views, values["lpips"], values["lpips_01"], strict=True)
    ]
    metrics = with_average(metrics)
    measured = [*values, AVERAGE] if AVERAGE in metrics[0].also else [*values]
    summary = dict(record.summary) | {name: mean_of(metrics, name) for name in measured}
    provenance = dict(record.provenance) | {LPIPS: network.name}
    filled = dataclasses.replace(record, summary=summary, provenance=provenance)
    others = {name: of for name, of in record.files.items() if name != METRICS_CSV}
    # a process killed between the two must not leave a table that the record calls damaged
    write_record(run_dir, dataclasses.replace(record, files=others))
    with following(run_dir) as written:
        write_whole(run_dir / METRICS_CSV, metrics_csv(metrics, stems))
    if record.files:  # else of a version that did not list them
        filled = dataclasses.replace(filled, files={**others, **written.listed()})
    write_record(run_dir, filled)
    return filled


def _saved_pair(folder: Path, stem: str) -> tuple[np.ndarray, np.ndarray]:
    """Render and truth [H, W, 3] uint8 as saved, white where the saved mask is not valid."""
    from framework.scenes.images import read_image, read_mask

    x, y = (np.array(read_image(folder / f"{stem}{kind}.png")) for kind in ("", "_truth"))
    require(
        x.shape == y.shape,
        f"{folder / stem}.png: expected an image of the truth's size {y.shape[1]}x{y.shape[0]}, got"
        f" {x.shape[1]}x{x.shape[0]}; delete the run's folder and run again",
    )
    mask = folder / f"{stem}_mask.png"
    if mask.is_file():
        valid = read_mask(mask, *x.shape[:2]) > 0.5
        x[~valid], y[~valid] = 255, 255
    return x, y


def _views(table: Table, run_dir: Path) -> list[ViewMetrics]:
    """The rows of a table of metrics as they were measured."""
    try:
        return [_view(table, i) for i in range(len(table.texts["view"]))]
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise UserError(
            f"{run_dir / METRICS_CSV}: expected a reason for every missing metric, got a damaged"
            f" table ({type(error).__name__}); delete the run's folder and run again"
        ) from None


def _view(table: Table, i: int) -> ViewMetrics:
    reasons = json.loads(table.texts["missing"][i] or "{}")
    numbers = {metric: float(column[i]) for metric, column in table.numbers.items()}
    render_s = numbers.pop("render_s")
    result = {m: Missing(str(reasons[m])) if math.isnan(v) else v for m, v in numbers.items()}
    return ViewMetrics(
        view=table.texts["view"][i],
        tags=tuple(table.texts["tags"][i].split()),
        render_s=render_s,
        **{metric: result.pop(metric) for metric in METRICS},
        also=result,
    )
