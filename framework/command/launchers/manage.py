"""`study submit|status|collect|cancel`: studies that outlive their command.

submit: checks the runs, starts workers (with `hydra/launcher=submitit_slurm` as jobs of SLURM, else
on this machine) and returns. status: how far the newest submission is, or the one that is named.
collect: builds the reports of the runs that have ended, even while others run. cancel: stops the
workers; runs keep their checkpoints, and the same `submit` does only what is missing.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from pathlib import Path

from framework.command.launchers.submission import Submission, read_submission, submissions
from framework.command.launchers.supported import missing_extra
from framework.command.studies.closing import short_path
from framework.command.studies.failures import conclude
from framework.command.studies.study import JOBS_VARIABLE, add_outcome, build_reports, ledger
from framework.errors import Arguments, UserError, printable_line, require
from framework.files.program import plugin_flags
from framework.records.progress import say

LAUNCHERS = ("submitit_local", "submitit_slurm")
LAUNCHER, SWEEP_DIR = "hydra/launcher=", "hydra.sweep.dir="
MOST_ROWS = 20


def main(arguments: Sequence[str], prog: str) -> int:
    """Exit code: 0, that of the runs (`collect`), or 2 for bad input."""
    if arguments[:1] == ["submit"]:
        return _submit(arguments[1:], f"{prog} submit")
    actions = {"status": _status, "collect": _collect, "cancel": _cancel}
    parser = Arguments(
        prog=prog, description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=("submit", *actions))
    parser.add_argument("name", nargs="?", help="of the submission (default: the newest)")
    parser.add_argument("--dir", type=Path, default=Path("reports"), help="hydra.sweep.dir, if set")
    parser.add_argument("--all", action="store_true", help="status: of all submissions")
    options = parser.parse_args(arguments)
    if options.what == "status" and options.all:
        return max(map(_status, map(read_submission, submissions(options.dir))), default=0)
    return actions[options.what](read_submission(_folder(options.dir, options.name)))


def _submit(words: Sequence[str], prog: str) -> int:
    """A multirun whose launcher starts the workers and returns."""
    from framework.command.cli import main as command_line

    if "-h" in words or "--help" in words:
        print(__doc__)
        return 0
    flags = [word for word in words if word not in ("-m", "--multirun")]
    chosen = [word.removeprefix(LAUNCHER) for word in words if word.startswith(LAUNCHER)]
    launcher = chosen[-1] if chosen else LAUNCHERS[0]
    require(
        len(flags) > len(chosen),
        f"{prog}: expected the words of a study, got none; write for instance {prog}"
        " reg=none,uar seed=0,1,2, or sweep=NAME",
    )
    require(
        launcher in LAUNCHERS,
        f"{prog}: expected {LAUNCHER}{f' or {LAUNCHER}'.join(LAUNCHERS)}, got {launcher!r}; a Ray"
        " cluster queues commands itself: ray job submit",
    )
    extra = missing_extra(launcher)
    require(
        extra is None,
        f"{prog}: expected submitit to be installed, found it missing; pip install"
        f" 'fishersplat[{extra}]'",
    )
    flags += [] if chosen else [f"{LAUNCHER}{launcher}"]
    code = command_line([*plugin_flags(), *flags, "hydra.launcher.detach=true", "-m"])
    if code == 0:
        sweep_dirs = [word.removeprefix(SWEEP_DIR) for word in words if word.startswith(SWEEP_DIR)]
        _status(read_submission(_folder(Path((sweep_dirs or ["reports"])[-1]))))
    return code


def _status(submission: Submission) -> int:
    ended, total = submission.ended().values(), len(submission.runs)
    failed = [outcome for outcome in ended if outcome.error and not outcome.busy]
    done = sum(outcome.error is None for outcome in ended)
    state = "all ended" if submission.complete() else "submitted"
    state = "cancelled" if submission.cancelled.exists() else state
    jobs = ", ".join(f"{count} {name}" for name, count in submission.job_states().items())
    lines = [
        f"{submission.folder.name}: {state}, {done} of {total} runs done, {len(failed)} failed,"
        f" {total - done - len(failed)} left; jobs: {jobs}",
        submission.command,
        *(f"failed: {short_path(Path(o.run_dir))} · {o.error}" for o in failed[:MOST_ROWS]),
    ]
    if len(failed) > MOST_ROWS:
        lines.append(f"... and {len(failed) - MOST_ROWS} more failed, `study collect` has them")
    for line in lines:
        say(printable_line(line))
    return 0


def _collect(submission: Submission) -> int:
    """Build the reports of the runs that have ended so far, and list the failures."""
    ended = submission.ended()
    with ledger():
        os.environ[JOBS_VARIABLE] = str(len(ended))
        for outcome in ended.values():
            add_outcome(outcome)
        if len(ended) < len(submission.runs):
            say(f"partial: {len(ended)} of {len(submission.runs)} runs have ended")
        build_reports()
        return conclude() if ended else 0


def _cancel(submission: Submission) -> int:
    submission.cancel()
    say(
        f"{submission.folder.name}: cancelled; runs keep their checkpoints, continue with:"
        f" {submission.command}"
    )
    return 0


def _folder(sweep_dir: Path, name: str | None = None) -> Path:
    """The newest submission, or the one that is named."""
    folders = submissions(sweep_dir)
    if not folders:
        wanted = "a submitted study" if name is None else f"the submission '{name}'"
        raise UserError(f"{sweep_dir}: expected {wanted}, found none; add --dir DIR")
    if name is None:
        return folders[-1]
    names = [folder.name for folder in folders]
    require(
        name in names,
        f"{name}: expected a submission, got none of that name; latest: {', '.join(names[-5:])}",
    )
    return folders[names.index(name)]
