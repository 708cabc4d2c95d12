"""`hydra/launcher=submitit_local` and `submitit_slurm`: a process, or a job of SLURM, for each run.

Hydra's launchers of these names, but: the study goes on where a job was lost; local ones are so
many at a time; each launch has a folder of its own, so that no other's results are read.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
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

from framework.command.launchers.detached import detached, submitted
from framework.command.launchers.page import write_page
from framework.command.launchers.plan import Run, new_plan, read_plan, work, write_plan
from framework.command.launchers.sent import Arrivals, Origin, chunks, lead_to_this_code, origin
from framework.command.studies.study import Outcome

ARRAY = 1000  # jobs of one array; SLURM's own limit, unless it was changed, is 1001
LOCAL_POLL_S, QUEUE_POLL_S = 0.1, 5.0
GRACE_S = 90.0  # a shared file system may show a file so late


class _Sent(BaseSubmititLauncher):
    """What both have in common."""

    origin: Origin

    def __call__(self, *job: Any) -> Any:
        """The outcome of one run, in its process."""
        self.origin.take()
        return super().__call__(*job).return_value

    @property
    def _sweep_dir(self) -> Path:
        assert self.config is not None
        folder = Path(str(self.config.hydra.sweep.dir))
        folder.mkdir(parents=True, exist_ok=True)
        return folder

    def _detach(self, runs: Sequence[Run], workers: int) -> None:
        """Start workers that do the runs when this process is gone."""
        self.origin = origin(outlives=True)
        signal.signal(signal.SIGHUP, signal.SIG_IGN)  # theirs too: of the terminal that closes
        plan = new_plan(self._sweep_dir, submitted(), self._EXECUTOR, runs)
        executor = self._executor_in(plan.folder / "log")
        worker = Worker(self, plan.folder, Singleton.get_state())
        with executor.batch():
            jobs = [executor.submit(worker) for _ in range(min(workers, len(runs)))]
        write_plan(replace(plan, jobs=tuple(map(_id, jobs))))
        write_page(plan)

    @contextmanager
    def _executor(self, seen: Arrivals) -> Iterator[Any]:
        """One of a folder that goes again unless a run was lost."""
        folder = Path(tempfile.mkdtemp(prefix=".submitit-", dir=self._sweep_dir))
        try:
            yield self._executor_in(folder)
        finally:
            if seen.lost == 0:
                shutil.rmtree(folder, ignore_errors=True)

    def _executor_in(self, folder: Path) -> Any:
        """submitit's, with what was asked for."""
        import submitit

        own = {k: v for k, v in self.params.items() if k not in ("submitit_folder", "n_jobs")}
        # submitit's local executor takes a number of timeouts, too, but Hydra's has no option
        timeouts = {f"{self._EXECUTOR}_max_num_timeout": own.pop("max_num_timeout", 0)}
        lead_to_this_code()
        executor = submitit.AutoExecutor(folder=folder, cluster=self._EXECUTOR, **timeouts)
        common = set(BaseQueueConf.__dataclass_fields__)
        executor.update_parameters(
            **{k if k in common else f"{self._EXECUTOR}_{k}": v for k, v in own.items()}
        )
        return executor

    def _arguments(self, run: Run) -> tuple[Any, ...]:
        """Those of `__call__`."""
        number, overrides = run
        state = Singleton.get_state()
        return overrides, "hydra.sweep.dir", number, f"job_id_for_{number}", state

    def _collect(self, job: Any, run: Run, seen: Arrivals) -> None:
        """The outcome of a job that has ended."""
        result = None
        if job.paths.result_pickle.exists():
            try:
                (result,) = job.results()
            except Exception as error:  # of submitit: the job's traceback
                last = str(error).strip().splitlines()[-1]
                return seen.vanished(run[1], f"{last} · log: {job.paths.stderr}")
        if isinstance(result, Outcome):
            return seen.arrived(result)
        return seen.vanished(run[1], f"its process was killed · log: {job.paths.stderr}")


@dataclass(frozen=True)
class Worker:
    """Does runs of a plan, one after another, in a process of submitit's."""

    launcher: _Sent
    folder: Path
    state: Any

    def __call__(self) -> None:
        self.launcher.origin.take()
        plan = read_plan(self.folder)
        work(plan, self._do, lambda: write_page(plan))

    def checkpoint(self) -> Any:
        """What SLURM is to start again where the time was up, or the node was needed."""
        import submitit

        return submitit.helpers.DelayedSubmission(self)

    def _do(self, run: Run) -> Outcome:
        number, overrides = run
        job = (overrides, "hydra.sweep.dir", number, f"job_id_for_{number}", self.state)
        outcome: Outcome = BaseSubmititLauncher.__call__(self.launcher, *job).return_value
        return outcome


class Local(_Sent, LocalLauncher):
    """n_jobs processes at a time on this machine, which end with the command."""

    def launch(
        self, job_overrides: Sequence[Sequence[str]], initial_job_idx: int
    ) -> Sequence[JobReturn]:
        """Do the runs; returns those that told how they ended."""
        asked = int(self.params["n_jobs"])
        at_once = asked if asked > 0 else os.cpu_count() or 1
        waiting = [(initial_job_idx + i, list(words)) for i, words in enumerate(job_overrides)]
        if detached():
            self._detach(waiting, at_once)
            return ()
        self.origin = origin(outlives=False)
        seen = Arrivals(len(waiting))
        running: list[tuple[Any, Run]] = []
        with self._executor(seen) as executor:
            try:
                while waiting or running:
                    while waiting and len(running) < at_once:
                        run = waiting.pop(0)
                        running.append((executor.submit(self, *self._arguments(run)), run))
                    for job, run in [pair for pair in running if pair[0].done()]:
                        running.remove((job, run))
                        self._collect(job, run, seen)
                    time.sleep(LOCAL_POLL_S)
            finally:
                for job, _ in running:  # interrupted
                    job.cancel(check=False)
        return seen.returns


class Slurm(_Sent, SlurmLauncher):
    """Arrays of jobs in SLURM's queue, which go on when the command is gone."""

    def launch(
        self, job_overrides: Sequence[Sequence[str]], initial_job_idx: int
    ) -> Sequence[JobReturn]:
        """Submit the runs and wait; returns those that told how they ended."""
        runs = [(initial_job_idx + i, list(words)) for i, words in enumerate(job_overrides)]
        if detached():
            self._detach(runs, min(ARRAY, int(self.params["array_parallelism"])))
            return ()
        self.origin = origin(outlives=True)
        seen = Arrivals(len(runs))
        with self._executor(seen) as executor:
            for some in chunks(runs, ARRAY):
                jobs = executor.map_array(self, *zip(*map(self._arguments, some), strict=True))
                self._wait(
                    dict(zip(map(_id, jobs), zip(jobs, some, strict=True), strict=True)), seen
                )
        return seen.returns

    def _wait(self, running: dict[str, Any], seen: Arrivals) -> None:
        """Until every job has a result, or has left the queue without one."""
        left: dict[str, float] = {}  # when a job was first not in the queue
        try:
            while running:
                queued = queue(running)
                for name, (job, run) in list(running.items()):
                    if name not in queued:
                        left.setdefault(name, time.monotonic())
                    else:
                        left.pop(name, None)
                    gone = name in left and time.monotonic() - left[name] > GRACE_S
                    if job.paths.result_pickle.exists() or gone:
                        del running[name]
                        self._collect(job, run, seen)
                time.sleep(QUEUE_POLL_S if running else 0)
        finally:
            if running:  # interrupted
                subprocess.run(["scancel", *running], check=False)


def queue(names: Sequence[str] | dict[str, Any]) -> set[str]:
    """Those jobs, `array_index`, that SLURM still has; all of them where it does not answer."""
    arrays = sorted({name.partition("_")[0] for name in names})
    command = ["squeue", "--noheader", "--array", "--format=%i", f"--jobs={','.join(arrays)}"]
    try:
        told = subprocess.run(command, capture_output=True, text=True, timeout=60)
    except (OSError, subprocess.TimeoutExpired):
        return set(names)
    if told.returncode != 0 and "Invalid job id" not in told.stderr:
        return set(names)
    return set(told.stdout.split())


def _id(job: Any) -> str:
    return str(job.job_id)
