"""Do one run in this process and show its progress."""

from __future__ import annotations

from pathlib import Path

from framework.command.collector import import_uncollected
from framework.command.job import Job
from framework.records.progress import Terminal
from framework.scenes import untested

VARIABLES = "FISHERSPLAT_"  # what the environment knows of the command, see `studies.study`


def run(job: Job) -> None:
    """Do a run. Raises what the run raises."""
    import_uncollected("framework.run.experiment")  # torch and the kernels: two seconds
    from framework.run.experiment import run_experiment

    tested = not untested(str(job.config["scene"].get("split")))
    in_place = None if job.alone else False
    progress = Terminal(job.label, job.short_label, in_place=in_place, tested=tested)
    run_experiment(job.config, Path(job.run_dir), progress, job.overrides)
