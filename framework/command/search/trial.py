"""One run of a search, in a process that does one after another and keeps scene and depth."""

from __future__ import annotations

import multiprocessing
from collections.abc import Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from framework.command.config.composed import configuration
from framework.command.runner import Job
from framework.command.studies.failures import record_failure
from framework.compute.orphans import end_with_parent
from framework.errors import UserError, printable_line
from framework.files.program import command_line
from framework.metrics.values import Missing
from framework.records.progress import Silent, say


@dataclass(frozen=True)
class Result:
    """Result of one run.

    Attributes:
        value: value of the metric; None if the run failed, with the reason in `error`.
        train_s: CPU seconds.
    """

    run_dir: str
    value: float | None
    train_s: float = 0.0
    error: str = ""


class Slot:
    """A process that does runs; when it is killed, the next run gets another one."""

    def __init__(self) -> None:
        self._pool: ProcessPoolExecutor | None = None

    def submit(self, words: Sequence[str], label: str, metric: str) -> Future[Result]:
        """Begin a run. Its future fails with BrokenProcessPool when the process was killed."""
        if self._pool is None:
            context = multiprocessing.get_context("spawn")
            self._pool = ProcessPoolExecutor(1, context, initializer=end_with_parent)
        return self._pool.submit(run, list(words), label, metric)

    def close(self) -> None:
        """Let the process end."""
        if self._pool is not None:
            self._pool.shutdown(wait=False, cancel_futures=True)
            self._pool = None


def job_of(words: Sequence[str]) -> Job:
    """The run that the words of a command line describe, checked."""
    run = configuration(words)
    return Job(
        number=0,
        run_dir=str(run.folder),
        config=run.values,
        overrides=list(words),
        label="",
        alone=False,
        multirun=True,
        again=command_line(words),
    )


def run(words: list[str], label: str, metric: str) -> Result:
    """Do a run; a failure is written into its record."""
    from framework.run.experiment import run_experiment

    try:
        job = job_of(words)
    except UserError as error:  # values of the trial that contradict each other
        say(printable_line(f"{label}: {error}"))
        return Result("", None, error=printable_line(str(error)))
    say(printable_line(label))
    try:
        record = run_experiment(job.config, Path(job.run_dir), Silent(), job.overrides)
    except Exception as error:
        return Result(job.run_dir, None, error=str(record_failure(job, error).error))
    value, cpu_s = record.summary[metric], record.train_cpu_s or 0.0
    if isinstance(value, Missing):
        return Result(job.run_dir, None, cpu_s, f"no {metric}: {value.reason}")
    return Result(job.run_dir, value, cpu_s)
