"""Do one run in this process and show its progress."""

from __future__ import annotations

import gc
import importlib
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from framework.records.progress import Terminal
from framework.scenes import untested

VARIABLES = "FISHERSPLAT_"  # prefix of the command's environment variables, see `studies.study`


@dataclass(frozen=True)
class Job:
    """One run of the command line, as plain data.

    Attributes:
        label, short_label: begin its progress lines.
        alone: no other run writes to the terminal.
        multirun: whether it is one of several.
        again: the command that does this run alone.
    """

    number: int
    run_dir: str
    config: dict[str, Any]
    overrides: list[str]
    label: str
    short_label: str
    alone: bool
    multirun: bool
    again: str


def run(job: Job) -> None:
    """Do a run. Raises what the run raises."""
    import_uncollected("framework.run.experiment")  # torch and the kernels: two seconds
    from framework.run.experiment import run_experiment

    tested = not untested(str(job.config["scene"].get("split")))
    in_place = None if job.alone else False
    progress = Terminal(job.label, job.short_label, in_place=in_place, tested=tested)
    run_experiment(job.config, Path(job.run_dir), progress, job.overrides)


def import_uncollected(module: str) -> None:
    """Import a module with the garbage collector off.

    Imports make hundreds of thousands of objects that live to the end; scanning them again and
    again takes 0.2 s with torch and numba. The objects are exempt from later collections too. A
    second import does nothing, so the garbage of a study's runs is collected.
    """
    if module in sys.modules:
        return
    enabled = gc.isenabled()
    gc.disable()
    try:
        importlib.import_module(module)
        gc.freeze()
    finally:
        if enabled:
            gc.enable()
