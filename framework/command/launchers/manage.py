"""`study submit|status|collect|cancel`: studies that outlive their command.

submit: checks the runs as the same words without `study submit` would, starts workers (with
`hydra/launcher=submitit_slurm` as jobs in SLURM's queue, else on this machine) and comes back.
status: how far the newest submission is, or the one that is named. collect: build the reports of
what is done, also while it goes on. cancel: stop the workers; runs keep their checkpoints, and the
same `submit` goes on from there and does only what is missing.
"""

from __future__ import annotations

import argparse
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from framework.command.launchers.detached import detach
from framework.command.launchers.page import status, told, write_page
from framework.command.launchers.plan import CANCELLED, PLAN, Plan, plans, read_plan
from framework.command.launchers.supported import missing_extra
from framework.command.studies.failures import conclude
from framework.command.studies.study import JOBS_VARIABLE, add_outcome, build_reports, ledger
from framework.errors import Arguments, UserError, require
from framework.files.whole import write_whole
from framework.records.progress import say

ENGINES = ("submitit_local", "submitit_slurm")
LAUNCHER = "hydra/launcher="


def main(arguments: Sequence[str], prog: str) -> int:
    """Exit code: 0, that of the runs (`collect`), or 2 for bad input."""
    if arguments[:1] == ["submit"]:
        return _submit(list(arguments[1:]), f"{prog} submit")
    parser = Arguments(
        prog=prog, description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=("submit", "status", "collect", "cancel"))
    parser.add_argument("name", nargs="?", help="of the submission (default: the newest)")
    parser.add_argument("--dir", type=Path, default=Path("reports"), help="hydra.sweep.dir, if set")
    parser.add_argument("--all", action="store_true", help="status: of all submissions")
    options = parser.parse_args(arguments)
    if options.what == "status" and options.all:
        for folder in plans(options.dir):
            _status(read_plan(folder))
        return 0
    plan = read_plan(_named(options.dir, options.name))
    if options.what == "status":
        return _status(plan)
    return _collect(plan) if options.what == "collect" else _cancel(plan)


def _submit(words: list[str], prog: str) -> int:
    """The usual way of a study, but that its launcher only starts workers."""
    from framework.command.cli import main as command_line
    from framework.command.words import MULTIRUN_FLAGS

    if "-h" in words or "--help" in words:
        print(__doc__)
        return 0
    require(
        any(word not in MULTIRUN_FLAGS and not word.startswith(LAUNCHER) for word in words),
        f"{prog}: expected the words of a study, got none; write for instance {prog}"
        " reg=none,uar seed=0,1,2, or sweep=NAME",
    )
    chosen = [word.removeprefix(LAUNCHER) for word in words if word.startswith(LAUNCHER)]
    require(
        all(name in ENGINES for name in chosen),
        f"{prog}: expected {' or '.join(LAUNCHER + name for name in ENGINES)}, got"
        f" {chosen[-1] if chosen else ''!r}; a Ray cluster has a queue of its own for commands: ray"
        " job submit",
    )
    extra = missing_extra(chosen[-1] if chosen else ENGINES[0])
    require(
        extra is None,
        f"{prog}: expected submitit to be installed, found it missing; pip install"
        f" 'fishersplat[{extra}]'",
    )
    flags = [word for word in words if word not in MULTIRUN_FLAGS]
    command = [*([] if chosen else [LAUNCHER + ENGINES[0]]), *flags, "-m"]
    detach(f"{prog} {shlex.join(words)}")
    try:
        code = command_line(command)
    finally:
        detach(None)
    if code == 0:
        folder = next(
            (w.partition("=")[2] for w in words if w.startswith("hydra.sweep.dir=")), "reports"
        )
        _status(read_plan(_named(Path(folder), None)))
    return code


def _status(plan: Plan) -> int:
    write_page(plan, force=True)
    for line in told(plan, status(plan), _queue(plan)):
        say(line)
    return 0


def _collect(plan: Plan) -> int:
    """Reports of all runs that are done so far, and the failures."""
    ended = plan.ended()
    with ledger():
        os.environ[JOBS_VARIABLE] = str(len(ended))
        for outcome in ended.values():
            add_outcome(outcome)
        if len(ended) < len(plan.runs):
            say(f"partial: {len(ended)} of {len(plan.runs)} runs have ended")
        build_reports()
        return conclude() if ended else 0


def _cancel(plan: Plan) -> int:
    """Running workers look for the file; those in SLURM's queue are taken out of it."""
    write_whole(plan.folder / CANCELLED, "")
    if plan.engine == "slurm" and plan.jobs:
        _asked(["scancel", "--state=PENDING", *plan.jobs])
    write_page(plan, force=True)
    say(f"{plan.folder.name}: cancelled; runs keep their checkpoints, go on with: {plan.command}")
    return 0


def _queue(plan: Plan) -> str:
    """What SLURM says of the workers."""
    if plan.engine != "slurm" or not plan.jobs:
        return ""
    jobs = ",".join(sorted({job.partition("_")[0] for job in plan.jobs}))
    out = _asked(["squeue", "--noheader", "--array", "--format=%T", f"--jobs={jobs}"])
    states = sorted(re.findall(r"[A-Z_]+", out or ""))
    if not states:
        return "; none of its jobs in SLURM's queue" if out is not None else ""
    counted = ", ".join(f"{states.count(s)} {s.lower()}" for s in dict.fromkeys(states))
    return f"; jobs in SLURM's queue: {counted}"


def _asked(command: list[str]) -> str | None:
    """What a command of SLURM's prints; None where it cannot be asked here."""
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    except (OSError, subprocess.TimeoutExpired) as error:
        print(f"{command[0]}: {error}", file=sys.stderr)
        return None
    return done.stdout


def _named(sweep_dir: Path, name: str | None) -> Path:
    known = plans(sweep_dir)
    if not known:
        wanted = "a submitted study" if name is None else f"the submission '{name}'"
        raise UserError(f"{sweep_dir}: expected {wanted}, found none; add --dir DIR")
    if name is None:
        return known[-1]
    found = [folder for folder in known if folder.name == name]
    names = ", ".join(folder.name for folder in known[-5:])
    require(
        len(found) == 1, f"{name}: expected a submission with a {PLAN}, got none; latest: {names}"
    )
    return found[0]
