"""A study that outlives its command: what was asked for, and how far it is, as files.

    reports/.submitted/<name>/plan.json     the command, its runs, the jobs that do them
                              outcomes/     one file per run that ended, as in a command's ledger
                              claims/       a lock for each run that a worker is at
                              log/          what the workers print, by submitit
                              cancelled     there when it was cancelled
                              status.html   the page

Workers take the runs in order, each the next that has no outcome and no claim. A claim is a lock of
the system, so that of a killed worker is free again and another takes its run up from the run's
checkpoint. A run that is complete already is reused, so the same command again does what is
missing.
"""

from __future__ import annotations

import contextlib
import json
import os
import platform
import re
import signal
import threading
import time
import typing
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from framework.command.studies.study import (
    LEDGER_VARIABLE,
    Outcome,
    build_reports,
    tell_jobs,
)
from framework.errors import UserError, require
from framework.files.documents import read_json
from framework.files.limits import RUN_BYTES, RUNS, TEXT_BYTES
from framework.files.locks import LOCK, Busy, locked
from framework.files.whole import write_whole

SUBMITTED, PLAN, CANCELLED, REPORTED = ".submitted", "plan.json", "cancelled", "reported"
CANCEL_POLL_S = 1.0
JOB = re.compile(r"\d{1,12}(_\d{1,7})?", re.ASCII)  # of SLURM, or a process

Run = tuple[int, list[str]]  # number and overrides


@dataclass(frozen=True)
class Plan:
    """runs: in the order of the command. engine: local or slurm. jobs: of the workers."""

    folder: Path
    command: str
    engine: str
    runs: tuple[Run, ...]
    jobs: tuple[str, ...] = ()

    @property
    def ledger(self) -> Path:
        return self.folder / "outcomes"

    @property
    def cancelled(self) -> bool:
        return (self.folder / CANCELLED).exists()

    def claim(self, number: int) -> Path:
        return self.folder / "claims" / f"{number:06d}"

    def ended(self) -> dict[int, Outcome]:
        """The outcomes so far, by the runs' numbers."""
        paths = sorted(self.ledger.glob("*.json"))
        return {o.number: o for o in (_outcome(path, self.folder.parents[1]) for path in paths)}


def new_plan(sweep_dir: Path, command: str, engine: str, runs: Sequence[Run]) -> Plan:
    """A plan in a folder of its own, named after the time, in order of creation."""
    stamp = time.strftime("%Y%m%d-%H%M%S")
    for count in range(1, 1000):
        folder = sweep_dir / SUBMITTED / (stamp if count == 1 else f"{stamp}-{count}")
        try:
            folder.mkdir(parents=True)
        except FileExistsError:
            continue
        plan = Plan(folder.absolute(), command, engine, tuple(runs))
        plan.ledger.mkdir()
        write_plan(plan)
        return plan
    raise UserError(f"{sweep_dir}: expected room for another submission, got a thousand; wait")


def write_plan(plan: Plan) -> None:
    """`plan.json`."""
    content = {
        "command": plan.command,
        "engine": plan.engine,
        "host": platform.node(),
        "jobs": plan.jobs,
        "runs": plan.runs,
    }
    write_whole(plan.folder / PLAN, json.dumps(content))


def read_plan(folder: Path) -> Plan:
    """Raises UserError where the folder holds no plan; its words are data, and never obeyed but by
    the workers that were started with it."""
    content = read_json(folder / PLAN, TEXT_BYTES)
    fits = (
        isinstance(content, dict)
        and {"command", "engine", "jobs", "runs"} <= content.keys()
        and isinstance(content["command"], str)
        and content["engine"] in ("local", "slurm")
        and isinstance(content["jobs"], list)
        and all(isinstance(job, str) and JOB.fullmatch(job) for job in content["jobs"])
        and isinstance(content["runs"], list)
        and len(content["runs"]) <= RUNS
        and all(map(_is_run, content["runs"]))
    )
    require(
        fits, f"{folder / PLAN}: expected a plan of `study submit`, got another file; submit anew"
    )
    runs = tuple((number, words) for number, words in content["runs"])
    jobs = tuple(content["jobs"])
    return Plan(folder.absolute(), content["command"], content["engine"], runs, jobs)


def plans(sweep_dir: Path) -> list[Path]:
    """The folders of all submissions, the newest last, by the time of their plans."""
    found = list((sweep_dir / SUBMITTED).glob(f"*/{PLAN}"))
    return [path.parent for path in sorted(found, key=lambda path: (path.stat().st_mtime_ns, path))]


def running(plan: Plan, ended: Sequence[int] | dict[int, Outcome]) -> dict[int, str]:
    """Number -> who is at it, of the runs that are being done."""
    found: dict[int, str] = {}
    for number, _ in plan.runs:
        if number in ended or not (plan.claim(number) / LOCK).exists():
            continue
        try:
            with locked(plan.claim(number)):
                pass
        except Busy as error:
            owner = re.search(r"got (.*?);", str(error))
            found[number] = owner[1] if owner else "another process"
    return found


def work(plan: Plan, do: Callable[[Run], Outcome], after: Callable[[], None]) -> None:
    """Do runs of the plan until none is left to take, then build the reports if all are done.

    do: does a run, which adds its outcome to the ledger. after: called after each.
    """
    os.environ[LEDGER_VARIABLE] = str(plan.ledger)
    tell_jobs([words for _, words in plan.runs])
    if plan.cancelled:  # while its worker waited in the queue
        return
    with _until_cancelled(plan):
        while _pass(plan, do, after):  # again: the run of a worker that was killed meanwhile
            pass
        if len(plan.ended()) == len(plan.runs):
            _report(plan)
        after()


def _pass(plan: Plan, do: Callable[[Run], Outcome], after: Callable[[], None]) -> int:
    """Once through all runs; returns how many were done."""
    done = 0
    for run in plan.runs:
        outcome_file = plan.ledger / f"{run[0]:06d}.json"
        if outcome_file.exists():
            continue
        with contextlib.suppress(Busy), _claimed(plan, run[0]):
            if outcome_file.exists():
                continue
            outcome = do(run)
            if outcome.busy:  # another command is at it, and will leave its record
                outcome_file.unlink(missing_ok=True)
                continue
            done += 1
            after()
    return done


@contextmanager
def _claimed(plan: Plan, number: int) -> Iterator[None]:
    with locked(plan.claim(number)):
        yield
    with contextlib.suppress(OSError):  # another waits there already
        plan.claim(number).rmdir()


@contextmanager
def _until_cancelled(plan: Plan) -> Iterator[None]:
    """Interrupts what goes on within when the study is cancelled; its runs keep their
    checkpoints."""
    over, main = threading.Event(), threading.get_ident()

    def watch() -> None:
        while not over.wait(CANCEL_POLL_S):
            if plan.cancelled:
                # a signal, as it also wakes who sleeps
                signal.pthread_kill(main, signal.SIGINT)
                return

    # a shell lets what it starts in the background ignore this signal
    signal.signal(signal.SIGINT, signal.default_int_handler)
    threading.Thread(target=watch, daemon=True).start()
    try:
        yield
    except KeyboardInterrupt:
        if not plan.cancelled:
            raise
    finally:
        over.set()


def _report(plan: Plan) -> None:
    """The reports of a study whose last run has ended, by one of its workers."""
    with contextlib.suppress(Busy), locked(plan.folder):
        if not (plan.folder / REPORTED).exists():
            build_reports()
            write_whole(plan.folder / REPORTED, "")


def _outcome(path: Path, sweep_dir: Path) -> Outcome:
    """Raises UserError for what no run of this sweep's folder wrote: reports are built there."""
    content, types = read_json(path, RUN_BYTES), typing.get_type_hints(Outcome)
    fits = (
        isinstance(content, dict)
        and content.keys() == types.keys()
        and all(isinstance(content[key], kind) for key, kind in types.items())
        and Path(content["run_dir"]).resolve().is_relative_to(sweep_dir.resolve())
    )
    require(
        fits, f"{path}: expected the outcome of a run of this study, got another file; remove it"
    )
    return Outcome(**content)


def _is_run(entry: Any) -> bool:
    return (
        isinstance(entry, list)
        and len(entry) == 2
        and type(entry[0]) is int
        and 0 <= entry[0] <= RUNS
        and isinstance(entry[1], list)
        and all(isinstance(word, str) for word in entry[1])
    )
