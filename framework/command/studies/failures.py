"""Failed runs: written to the record and the ledger, listed at the end, turned into an exit code.

The list on stderr has a line per failed run with its folder, the kind of failure and the reason,
and below it the command that does this run alone. For a single run it is the reason alone.
"""

from __future__ import annotations

import contextlib
import shutil
import sys
import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from framework.command.complaints import USER_ERRORS, one_line, with_variant
from framework.command.runner import Job
from framework.command.studies.closing import short_path
from framework.command.studies.study import (
    REPORT,
    Outcome,
    add_outcome,
    job_count,
    outcomes,
)
from framework.errors import UserError, machine_line, mendable
from framework.files.locks import Busy
from framework.files.program import command_line
from framework.records import RUN_FOLDERS

MOST_ROWS = 20
LAUNCHING = ("hydra.mode=", "hydra/launcher=", "hydra.launcher.")


def kind_of(error: BaseException) -> str:
    """A word or two for what went wrong."""
    if isinstance(error, UserError):
        return error.kind
    if isinstance(error, USER_ERRORS):
        return UserError.kind
    return "machine" if isinstance(error, OSError) or machine_line(error) else "bug"


def record_failure(job: Job, error: Exception) -> Outcome:
    """Write a failure into the run's record, unless the run never began, and into the ledger.

    Returns:
        The entry of the ledger.
    """
    message, kind = _shown(error, job.config["traceback"]), kind_of(error)
    message = with_variant(message, job.overrides)
    bad_input, busy = isinstance(error, USER_ERRORS), isinstance(error, Busy)
    about_path = isinstance(error, OSError) and mendable(error)
    fixable = bad_input or machine_line(error) is not None  # by the user
    if busy:
        pass  # the other process writes the record
    elif job.multirun or not (bad_input or about_path):
        message = _recorded(job, message, kind)
    else:  # a lone mistyped run is not worth a record, nor a folder
        _discard(Path(job.run_dir))
    outcome = Outcome(job.number, job.run_dir, message, kind, job.again, fixable, busy)
    add_outcome(outcome)
    return outcome


def again(job: Any) -> str:
    """Return the command that does this run alone, in the same folder.

    Args:
        job: Hydra's part of the configuration.
    """
    flags = [str(o) for o in job.overrides.hydra if not str(o).lstrip("+").startswith(LAUNCHING)]
    words = [*flags, *(str(override) for override in job.overrides.task)]
    multirun = ["-m"] if job.mode.name == "MULTIRUN" else []
    return command_line([*words, *multirun])


def conclude() -> int:
    """Print which runs failed or are missing; returns the exit code."""
    ended = outcomes()
    failed = [outcome for outcome in ended if outcome.error is not None and not outcome.busy]
    busy = [outcome for outcome in ended if outcome.busy]
    total = job_count() or len(ended)
    lost = total - sum(outcome.kind != REPORT for outcome in ended)
    if failed:
        print("\n".join(_failure_lines(failed, total)), file=sys.stderr)
    if lost > 0:
        print(f"error: {lost} runs ended without a result", file=sys.stderr)
    if busy:
        first = f"{busy[0].error}" if total == 1 else f"for instance {busy[0].error}"
        count = "" if total == 1 else f"another process does {len(busy)} of {total} runs, "
        print(f"error: {count}{first}; then repeat the same command", file=sys.stderr)
    if failed or lost > 0:
        return 2 if lost <= 0 and all(outcome.bad_input for outcome in failed) else 1
    return 3 if busy else 0


def _failure_lines(failed: Sequence[Outcome], total: int) -> list[str]:
    """The lines about failed runs."""
    runs = [outcome for outcome in failed if outcome.kind != REPORT]
    if total == 1 or not runs:
        return [f"error: {outcome.error}" for outcome in failed]
    lines = [
        f"error: {len(runs)} of {total} runs failed; the same command repeats them, the command"
        " below each repeats it alone",
        *_table(runs[:MOST_ROWS]),
    ]
    if len(runs) > MOST_ROWS:
        lines.append(f"  ... and {len(runs) - MOST_ROWS} more, see the report")
    return [*lines, *(f"error: {o.error}" for o in failed if o.kind == REPORT)]


def _table(failed: Sequence[Outcome]) -> list[str]:
    rows = [("run", "kind", "reason")]
    rows += [(str(short_path(Path(o.run_dir))), o.kind, str(o.error)) for o in failed]
    wide, kind_wide = (max(len(row[column]) for row in rows) for column in (0, 1))
    lines = [f"  {run:{wide}}  {kind:{kind_wide}}  {reason}" for run, kind, reason in rows]
    commands = [f"    {outcome.again}" for outcome in failed]
    return [lines[0], *(line for pair in zip(lines[1:], commands, strict=True) for line in pair)]


def _shown(error: Exception, show: bool) -> str:
    """The one-line message of a failed run; a bug shows its traceback at once."""
    line = one_line(error) if isinstance(error, USER_ERRORS) else machine_line(error)
    if show or line is None:
        traceback.print_exception(error)
    first = next(iter(str(error).splitlines()), "")
    return line or f"{type(error).__name__}: {first}".rstrip(": ")


def _recorded(job: Job, message: str, kind: str) -> str:
    """Write the error into the run's folder; returns it, with the reason if that fails."""
    from framework.records.record import write_failed

    try:
        write_failed(
            Path(job.run_dir), job.config, job.overrides, message, kind=kind, again=job.again
        )
    except UserError as error:
        return message if str(error) in message else f"{message}; {error}"
    return message


def _discard(run_dir: Path) -> None:
    """Remove Hydra's files of a run that never began, and our study's folder if it is empty."""
    if not run_dir.is_dir() or [path.name for path in run_dir.iterdir()] != [".hydra"]:
        return  # or somebody removed it
    shutil.rmtree(run_dir / ".hydra")
    ours = run_dir.parents[:2] if run_dir.parent.name == RUN_FOLDERS else ()
    with contextlib.suppress(OSError):  # not empty: other runs are there
        for folder in (run_dir, *ours):
            folder.rmdir()
