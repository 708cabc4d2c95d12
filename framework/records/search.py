"""`search.json` beside the runs of a search: what varied, and how every trial ended.

`framework.command.search` writes it, the report shows it. Only data: a forged file is refused.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from framework.files.documents import read_json
from framework.files.limits import RUN_BYTES
from framework.files.opened import is_file, reading
from framework.metrics.values import METRICS

SEARCH = "search.json"


@dataclass(frozen=True)
class Trial:
    """A trial.

    Attributes:
        words: the options that varied.
        value: of the metric; None if the trial failed, with the reason in error.
        run: name of the run's folder.
        train_s: CPU seconds of the training.
    """

    number: int
    value: float | None
    words: tuple[str, ...]
    run: str
    train_s: float
    error: str


@dataclass(frozen=True)
class Searched:
    """fixed: the words that all trials share. trials: in their order."""

    metric: str
    fixed: tuple[str, ...]
    trials: tuple[Trial, ...]


def read_search(folder: Path) -> Searched | None:
    """The search whose runs are in `folder`; None where there was none.

    Raises:
        UserError: for a file that no search wrote.
    """
    path = folder / SEARCH
    if not is_file(path):
        return None
    content = read_json(path, RUN_BYTES)
    with reading(path, "the trials of a search", "remove it"):
        metric = METRICS[METRICS.index(content["metric"])]
        fixed, trials = map(str, content["fixed"]), map(_trial, content["trials"])
        searched = Searched(metric, tuple(fixed), tuple(trials))
    return searched


def _trial(entry: Any) -> Trial:
    value = entry["value"]
    return Trial(
        number=int(entry["number"]),
        value=None if value is None else float(value),
        words=tuple(map(str, entry["words"])),
        run=str(entry["run"] or ""),
        train_s=float(entry["train_s"] or 0.0),
        error=str(entry["error"] or ""),
    )
