"""Compose a configuration, run an experiment, and read the folder of a run."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd

from fishersplat.arguments import composed, expect_folder
from framework.errors import require
from framework.records.record import RunRecord, read_run
from framework.records.run_files import Table
from framework.view.runs import find_run

if TYPE_CHECKING:
    from framework.exports.opened import OpenedRun
    from framework.types import Camera, Gaussians


@dataclass(frozen=True)
class Run:
    """A completed run.

    Attributes:
        folder: the folder that `load_run` read.
        record: configuration, scene, timings, versions and summary (`record.json`).
        metrics: one row per test view: `view`, `psnr` in dB, `ssim`, `flip`, `lpips`, ...
        history: one row per logged step: `step`, `seconds`, `loss`, `test_psnr` in dB, `gaussians`.
    """

    folder: Path
    record: RunRecord
    metrics: pd.DataFrame
    history: pd.DataFrame

    @cached_property
    def gaussians(self) -> Gaussians:
        """The trained Gaussians, with `means` [N, 3], `quats` [N, 4] and so on."""
        return self._opened.gaussians

    @cached_property
    def cameras(self) -> dict[str, Camera]:
        """Cameras of training and test views by name; `viewmat` is world to camera, OpenCV axes."""
        from framework.exports.opened import read_named_cameras
        from framework.records.cameras import TRANSFORMS

        return {entry.name: entry.camera for entry in read_named_cameras(self.folder / TRANSFORMS)}

    @cached_property
    def _opened(self) -> OpenedRun:
        from framework.exports.opened import open_run

        return open_run(self.folder)


def run(*options: str, folder: Path | str | None = None, quiet: bool = False) -> Run:
    """Train and evaluate one run, or load it if it is complete.

    Args:
        options: words of the command line, for instance `"augment=safi"`, `"trainer.steps=300"`.
        folder: folder of the run; by default `reports/STUDY/runs/NAME` in the current folder.
        quiet: print no progress.

    Returns:
        The completed run.

    Raises:
        UserError: An option, file or scene is invalid.
    """
    chosen = composed("run", options)
    require(
        not chosen.values["estimate"],
        "run: estimate: expected false, got an estimate of a study; use the command line",
    )
    target = chosen.folder if folder is None else expect_folder("run", folder, "folder='DIR'")
    from framework.records.progress import Silent, Terminal
    from framework.run.experiment import run_experiment

    values = chosen.values
    label = f"{values['augment']['name']}+{values['reg']['name']} seed {values['seed']}"
    target.mkdir(parents=True, exist_ok=True)
    run_experiment(values, target, Silent() if quiet else Terminal(label), chosen.options)
    return load_run(target)


def load_run(path: Path | str) -> Run:
    """Read the folder of a completed run.

    Args:
        path: a folder such as `reports/STUDY/runs/NAME`, or that of a study with one run.

    Raises:
        UserError: The folder has no completed run, or its files are damaged.
    """
    folder = find_run(expect_folder("load_run", path, "reports/STUDY/runs/NAME"))
    result = read_run(folder)
    require(
        result.record.status == "complete",
        f"{folder}: expected a completed run, got one with status '{result.record.status}'; run it"
        " again",
    )
    return Run(folder, result.record, _frame(result.metrics), _frame(result.history))


def _frame(table: Table) -> pd.DataFrame:
    return pd.DataFrame({**table.texts, **table.numbers})
