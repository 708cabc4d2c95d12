"""A study handed to submitit: its runs, the jobs that do them and how far they are.

    reports/.submitted/NAME/submission.json  the command, its runs, the ids of its jobs
                            outcomes/        one file per run that has ended
                            log/             submitit's folder
                            cancelled        exists once the study was cancelled

Each job is a worker that does one run after another. The lock of a run's folder keeps two workers
from doing the same run. The lock of a killed worker is free, so another worker resumes its run from
the checkpoint. Complete runs are reused, so repeating the command does what is missing.
"""

from __future__ import annotations

import dataclasses
import json
import os
import signal
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from framework.command.studies.study import (
    LEDGER_VARIABLE,
    REPORT,
    Outcome,
    build_reports,
    read_outcomes,
)
from framework.errors import UserError
from framework.files.documents import read_json
from framework.files.limits import TEXT_BYTES
from framework.files.whole import write_whole

SUBMITTED, FILE, REPORTED = ".submitted", "submission.json", "reported"
POLL_S = 1.0

Run = tuple[int, list[str]]  # number and overrides


@dataclass(frozen=True)
class Submission:
    """A submitted study.

    Attributes:
        cluster: "local" or "slurm".
        runs: the runs in the order of the command.
        jobs: the job ids of the workers.
        detached: whether the command does not wait, so that a worker builds the reports.
    """

    folder: Path
    command: str
    cluster: str
    runs: Sequence[Run]
    detached: bool = False
    jobs: Sequence[str] = ()

    @property
    def log(self) -> Path:
        return self.folder / "log"

    @property
    def ledger(self) -> Path:
        return self.folder / "outcomes"

    @property
    def cancelled(self) -> Path:
        return self.folder / "cancelled"

    def save(self) -> None:
        content = {**dataclasses.asdict(self), "folder": None}
        write_whole(self.folder / FILE, json.dumps(content))

    def ended(self) -> dict[int, Outcome]:
        """The outcomes so far, by the runs' numbers.

        A `busy` outcome is replaced by that of the worker that does the run, which sorts later.
        """
        return {o.number: o for o in read_outcomes(self.ledger) if o.kind != REPORT}

    def complete(self) -> bool:
        return sum(not outcome.busy for outcome in self.ended().values()) == len(self.runs)

    def job_states(self) -> Counter[str]:
        """Count the jobs in each of submitit's states."""
        return Counter(self._state(job) for job in self._jobs())

    def cancel(self) -> None:
        """Workers look for the file; jobs in SLURM's queue are taken out of it as well."""
        write_whole(self.cancelled, "")
        for job in self._jobs():
            job.cancel(check=False)

    def _jobs(self) -> list[Any]:
        import submitit

        kind = submitit.SlurmJob if self.cluster == "slurm" else submitit.LocalJob
        return [kind(self.log, job) for job in self.jobs]

    def _state(self, job: Any) -> str:
        """submitit only reports whether a local job of another command has a result."""
        state = str(job.state)
        if self.cluster == "slurm" or state == "FINISHED":
            return state.lower()
        with suppress(ProcessLookupError):
            os.kill(int(job.job_id), 0)
            return "running"
        return "killed"


def new_submission(
    sweep_dir: Path, command: str, cluster: str, runs: Sequence[Run], detached: bool
) -> Submission:
    """Make a folder for a submission, named after the time."""
    (sweep_dir / SUBMITTED).mkdir(parents=True, exist_ok=True)
    stamp = time.strftime("%Y%m%d-%H%M%S-")
    folder = Path(tempfile.mkdtemp(prefix=stamp, dir=sweep_dir / SUBMITTED)).absolute()
    submission = Submission(folder, command, cluster, runs, detached)
    submission.ledger.mkdir()
    submission.save()
    return submission


def read_submission(folder: Path) -> Submission:
    """Raises UserError where the folder holds no submission."""
    content = read_json(folder / FILE, TEXT_BYTES)
    try:
        submission = Submission(**{**content, "folder": folder.absolute()})
        runs = [(int(number), list(words)) for number, words in submission.runs]
    except (TypeError, ValueError) as error:
        raise UserError(
            f"{folder / FILE}: expected a file of `study submit`, got another; submit again"
        ) from error
    return dataclasses.replace(submission, runs=runs)


def submissions(sweep_dir: Path) -> list[Path]:
    """The folders of all submissions, the newest last."""
    files = (sweep_dir / SUBMITTED).glob(f"*/{FILE}")
    return [file.parent for file in sorted(files, key=lambda file: file.stat().st_mtime_ns)]


def work(submission: Submission, do: Callable[[Run], Outcome], index: int = 0) -> None:
    """Do the runs that no other worker has done or is doing, then build the reports if all ended.

    Args:
        do: does a run.
        index: of the first run to try, so that workers do not all start with the same.
    """
    if submission.cancelled.exists():  # while its job waited in the queue
        return
    _interrupt_when_cancelled(submission)
    runs = [*submission.runs[index:], *submission.runs[:index]]
    while any([_attempt(submission, run, do) for run in runs]):
        pass  # again: a worker may have been killed meanwhile
    if submission.detached and submission.complete():
        _report(submission)


def _attempt(submission: Submission, run: Run, do: Callable[[Run], Outcome]) -> bool:
    """Do a run unless it has ended or another process is doing it; returns whether it was done."""
    name = f"{run[0]:06d}"
    if (submission.ledger / f"{name}.json").exists():
        return False
    outcome = do(run)
    name += ".busy" if outcome.busy else ""
    write_whole(submission.ledger / f"{name}.json", json.dumps(dataclasses.asdict(outcome)))
    return not outcome.busy


def _report(submission: Submission) -> None:
    """Build the reports, in one worker only."""
    with suppress(FileExistsError):
        (submission.folder / REPORTED).mkdir()
        os.environ[LEDGER_VARIABLE] = str(submission.ledger)
        build_reports()


def _interrupt_when_cancelled(submission: Submission) -> None:
    """Interrupt this process when the study is cancelled; its run keeps its checkpoint."""
    main = threading.get_ident()

    def watch() -> None:
        while not submission.cancelled.exists():
            time.sleep(POLL_S)
        signal.pthread_kill(main, signal.SIGINT)  # also wakes a thread that sleeps

    # a shell lets what it starts in the background ignore this signal
    signal.signal(signal.SIGINT, signal.default_int_handler)
    threading.Thread(target=watch, daemon=True).start()
