"""Who does a run: this process, or the one that waits for the command line's runs (see `entry`).

A run is asked for as a line of JSON, and the answer is whether it went well. One that failed has
been told by then, in its record and the ledger (`framework.command.studies.failures`).
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import TextIO

from framework.command.collector import import_uncollected
from framework.command.job import Job
from framework.errors import UserError
from framework.records.progress import Terminal
from framework.scenes import untested

EXPERIMENT = "framework.run.experiment"
REPORT = ("framework.report", "pandas", "matplotlib.backends.backend_svg", "PIL.WebPImagePlugin")
VARIABLES = "FISHERSPLAT_"  # what the environment knows of the command, see `studies.study`

_parent: TextIO | None = None  # in the child: whom to ask for runs


def ask(parent: TextIO) -> None:
    """From now on `run` asks the process at the other end of `parent`."""
    global _parent
    _parent = parent


def run(job: Job) -> bool:
    """Do a run, by the parent if it waits for them. Raises what the run raises, or returns False
    where the parent has told of it."""
    if _parent is not None:
        return _asked(_parent, job)
    import_uncollected(EXPERIMENT)
    from framework.run.experiment import run_experiment

    tested = not untested(str(job.config["scene"].get("split")))
    in_place = None if job.alone else False
    progress = Terminal(job.label, job.short_label, in_place=in_place, tested=tested)
    run_experiment(job.config, Path(job.run_dir), progress, job.overrides)
    return True


def _asked(parent: TextIO, job: Job) -> bool:
    """Whether the run went well that the parent does."""
    known = {name: text for name, text in os.environ.items() if name.startswith(VARIABLES)}
    answer = ""
    with contextlib.suppress(ConnectionError):
        print(json.dumps([known, dataclasses.asdict(job)]), file=parent, flush=True)
        if job.config["threads"] != 1:  # else the core is for the run
            _importing(REPORT)
        answer = parent.readline()
    if not answer:  # the run was killed: leave everything as it left it
        os._exit(1)
    well = json.loads(answer)
    if well is None:
        raise KeyboardInterrupt
    if isinstance(well, str):
        raise UserError(well)
    return bool(well)


def serve(child: TextIO) -> None:
    """Do the runs that the child asks for, until it has ended."""
    imports = _importing([EXPERIMENT])
    with contextlib.suppress(ConnectionError):
        for line in child:
            known, wanted = json.loads(line)
            os.environ.update(known)
            well: bool | str | None = None  # interrupted
            with contextlib.suppress(KeyboardInterrupt):
                imports.join()
                well = _done(Job(**wanted))
            print(json.dumps(well), file=child, flush=True)


def _done(job: Job) -> bool | str:
    """Whether the run went well; a text where it did not and that could not be told, either."""
    try:
        return run(job)
    except (Exception, SystemExit) as error:
        from framework.command.studies.failures import tell

        try:
            tell(job, error if isinstance(error, Exception) else UserError(f"sys.exit: {error}"))
        except Exception as lost:
            return str(lost) if isinstance(lost, UserError) else f"{type(lost).__name__}: {lost}"
        return False


def _importing(modules: Sequence[str]) -> threading.Thread:
    """Import `modules` in a thread; an error is met by whoever imports them next."""

    def work() -> None:
        with contextlib.suppress(Exception):
            for module in modules:
                import_uncollected(module)

    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    return thread
