"""Runs in other processes, perhaps on other machines: their environment and their outcomes.

A run gets the command's current folder and its variables `FISHERSPLAT_*`, so relative paths, the
cache and the user's plugins are the same there. All machines must share that folder.
"""

from __future__ import annotations

import os
import platform
import site
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from hydra.core.utils import JobReturn, JobStatus

from framework.command.runner import VARIABLES
from framework.command.studies.closing import short_path
from framework.command.studies.study import LEDGER_VARIABLE, Outcome, add_outcome
from framework.compute.orphans import end_with
from framework.errors import printable_line
from framework.records.progress import say

PATH = "PYTHONPATH"


@dataclass(frozen=True)
class Origin:
    """The environment of the command.

    Attributes:
        command: host and process that runs must not outlive, None if they may.
    """

    folder: str
    variables: dict[str, str]
    command: tuple[str, int] | None

    def take(self) -> None:
        """Make this process one of the command's."""
        os.chdir(self.folder)
        for name in [name for name in os.environ if name.startswith(VARIABLES)]:
            del os.environ[name]
        os.environ.update(self.variables)
        if self.command is not None and self.command[0] == platform.node():
            end_with(self.command[1])


def origin(outlives: bool) -> Origin:
    """The origin of runs that this process sends out; `outlives` lets them continue without it."""
    variables = {
        name: text
        for name, text in os.environ.items()
        if name.startswith(VARIABLES) and name != LEDGER_VARIABLE
    }
    return Origin(os.getcwd(), variables, None if outlives else (platform.node(), os.getpid()))


def lead_to_this_code() -> None:
    """Make Python processes that start from here import this code.

    For `python run.py` another version may be installed, or none.
    """
    place = str(Path(__file__).resolve().parents[3])
    if place in map(os.path.realpath, site.getsitepackages()):
        return  # already importable; in front it would hide modules of Python
    others = [part for part in os.environ.get(PATH, "").split(os.pathsep) if part != place]
    os.environ[PATH] = os.pathsep.join(filter(None, [place, *others]))


class Arrivals:
    """The runs of one launch as they end: a line for each, their outcomes in the ledger."""

    def __init__(self, n_runs: int) -> None:
        self._n_runs, self._ended = n_runs, 0
        self.returns: dict[int, JobReturn] = {}

    def arrived(self, outcome: Outcome) -> None:
        """A run has an outcome; the second time nothing happens."""
        if outcome.number in self.returns:
            return
        add_outcome(outcome)
        self.returns[outcome.number] = JobReturn(_return_value=outcome, status=JobStatus.COMPLETED)
        reason = "" if outcome.error is None else f" · {outcome.error}"
        self._say(f"{short_path(Path(outcome.run_dir))}{reason}")

    def lost(self, overrides: Sequence[str], why: str) -> None:
        """The process of a run ended without an outcome."""
        self._say(f"lost: {' '.join(overrides)} · {why}")

    def _say(self, text: str) -> None:
        self._ended += 1
        say(printable_line(f"[{self._ended} of {self._n_runs} ended] {text}"))
