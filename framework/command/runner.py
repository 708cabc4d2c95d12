"""Do one run in this process and show its progress."""

from __future__ import annotations

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
        label: begins its progress lines.
        alone: no other run writes to the terminal.
        multirun: whether it is one of several.
        again: the command that does this run alone.
    """

    number: int
    run_dir: str
    config: dict[str, Any]
    overrides: list[str]
    label: str
    alone: bool
    multirun: bool
    again: str


def run(job: Job) -> None:
    """Do a run. Raises what the run raises."""
    from framework.run.experiment import run_experiment

    tested = not untested(str(job.config["scene"].get("split")))
    in_place = None if job.alone else False
    progress = Terminal(job.label, in_place=in_place, tested=tested)
    run_experiment(job.config, Path(job.run_dir), progress, job.overrides)
