"""`hydra/launcher=submitit_local` and `submitit_slurm`: workers on this machine or jobs of SLURM.

They differ from Hydra's launchers of these names. A worker does many runs, and a lost worker does
not end the study. With `hydra.launcher.detach=true` (`study submit`) the command does not wait.
"""

from __future__ import annotations

import os
import shutil
import signal
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from hydra.core.singleton import Singleton
from hydra.core.utils import JobReturn
from hydra_plugins.hydra_submitit_launcher.config import BaseQueueConf
from hydra_plugins.hydra_submitit_launcher.submitit_launcher import (
    BaseSubmititLauncher,
    LocalLauncher,
    SlurmLauncher,
)

from framework.command.launchers.sent import Arrivals, Origin, lead_to_this_code, origin
from framework.command.launchers.submission import (
    Run,
    Submission,
    new_submission,
    read_submission,
    work,
)
from framework.command.studies.study import Outcome
from framework.files.program import command_line

ARRAY = 1000  # jobs of one array; SLURM's own limit is 1001 unless it was changed
POLL_S = 0.2
NOT_SUBMITITS = ("submitit_folder", "n_jobs", "detach", "max_num_timeout")


class _Workers(BaseSubmititLauncher):
    """What both have in common."""

    def launch(
        self, job_overrides: Sequence[Sequence[str]], initial_job_idx: int
    ) -> Sequence[JobReturn]:
        """Do the runs; returns those that have an outcome."""
        assert self.config is not None
        detach = bool(self.params["detach"])
        submission = new_submission(
            Path(str(self.config.hydra.sweep.dir)),
            _command(self.config.hydra.overrides),
            self._EXECUTOR,
            [(initial_job_idx + i, list(words)) for i, words in enumerate(job_overrides)],
            detach,
        )
        if detach:
            signal.signal(signal.SIGHUP, signal.SIG_IGN)  # workers outlive a terminal that closes
        jobs = self._submit(submission, origin(outlives=detach or self._EXECUTOR == "slurm"))
        return [] if detach else _wait(submission, jobs)

    def at_once(self) -> int:
        """The number of workers at a time."""
        raise NotImplementedError

    def _submit(self, submission: Submission, start: Origin) -> list[Any]:
        """Start the workers."""
        executor = self._executor(submission.log)
        count = min(self.at_once(), len(submission.runs))
        worker = Worker(self, submission.folder, start, Singleton.get_state())
        with executor.batch():
            jobs = [executor.submit(replace(worker, index=index)) for index in range(count)]
        replace(submission, jobs=[str(job.job_id) for job in jobs]).save()
        return jobs

    def _executor(self, folder: Path) -> Any:
        """submitit's, with the options of the command."""
        import submitit

        lead_to_this_code()
        # submitit's local executor takes a number of timeouts, too, but Hydra's has no option
        timeouts = {f"{self._EXECUTOR}_max_num_timeout": self.params.get("max_num_timeout", 0)}
        executor = submitit.AutoExecutor(folder=folder, cluster=self._EXECUTOR, **timeouts)
        options = {k: v for k, v in self.params.items() if k not in NOT_SUBMITITS}
        common = BaseQueueConf.__dataclass_fields__
        executor.update_parameters(
            **{k if k in common else f"{self._EXECUTOR}_{k}": v for k, v in options.items()}
        )
        return executor


class Local(_Workers, LocalLauncher):
    """n_jobs processes on this machine, which end with the command unless it detaches."""

    def at_once(self) -> int:
        jobs = int(self.params["n_jobs"])
        return jobs if jobs > 0 else os.cpu_count() or 1


class Slurm(_Workers, SlurmLauncher):
    """An array of jobs, which go on when the command is gone."""

    def at_once(self) -> int:
        return min(ARRAY, int(self.params["array_parallelism"]))


@dataclass(frozen=True)
class Worker:
    """Does runs of a submission, one after another, in a process of submitit's."""

    launcher: _Workers
    folder: Path
    origin: Origin
    state: Any
    index: int = 0

    def __call__(self) -> None:
        self.origin.take()
        work(read_submission(self.folder), self._do, self.index)

    def checkpoint(self) -> Any:
        """What SLURM is to start again where the time was up, or the node was needed."""
        import submitit

        return submitit.helpers.DelayedSubmission(self)

    def _do(self, run: Run) -> Outcome:
        number, overrides = run
        job = (overrides, "hydra.sweep.dir", number, f"job_id_for_{number}", self.state)
        outcome: Outcome = BaseSubmititLauncher.__call__(self.launcher, *job).return_value
        return outcome


def _wait(submission: Submission, jobs: Sequence[Any]) -> list[JobReturn]:
    """Report the runs as they end, until the last job has ended; cancel them if interrupted."""
    seen, over = Arrivals(len(submission.runs)), False
    try:
        while not over:
            time.sleep(POLL_S)
            over = all(job.done() for job in jobs)
            for outcome in submission.ended().values():
                if over or not outcome.busy:
                    seen.arrived(outcome)
    finally:
        if not over:
            replace(submission, jobs=[str(job.job_id) for job in jobs]).cancel()
    lost = [words for number, words in submission.runs if number not in seen.returns]
    for words in lost:
        seen.lost(words, f"its process was killed · log: {submission.log}")
    if not lost:
        shutil.rmtree(submission.folder, ignore_errors=True)
    return list(seen.returns.values())


def _command(overrides: Any) -> str:
    """The command that submits this study again."""
    words = [*overrides.hydra, *overrides.task]
    left_out = ("hydra.launcher.detach=true", "hydra.mode=MULTIRUN")
    typed = [word for word in words if word not in left_out]
    return command_line(["study", "submit", *typed])
