"""`search.json` beside the runs of a search: what varied, and how every trial ended.

`framework.command.search` writes it, the report shows it. Only data: a forged file is refused.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from framework.errors import require
from framework.files.documents import read_json
from framework.files.limits import RUN_BYTES
from framework.files.opened import is_file
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
    fits = (
        isinstance(content, dict)
        and content.get("metric") in METRICS
        and _texts(content.get("fixed"))
        and isinstance(content.get("trials"), list)
        and all(map(_is_trial, content["trials"]))
    )
    require(fits, f"{path}: expected the trials of a search, got another file; remove it")
    trials = tuple(
        Trial(
            *(t["number"], t["value"], tuple(t["words"]), t["run"] or ""),
            *(float(t["train_s"] or 0.0), t["error"] or ""),
        )
        for t in content["trials"]
    )
    return Searched(content["metric"], tuple(content["fixed"]), trials)


def _is_trial(entry: Any) -> bool:
    return (
        isinstance(entry, dict)
        and {"number", "value", "words", "run", "train_s", "error"} <= entry.keys()
        and type(entry["number"]) is int
        and isinstance(entry["value"], float | int | None)
        and _texts(entry["words"])
        and all(isinstance(entry[key], str | None) for key in ("run", "error"))
        and isinstance(entry["train_s"], float | int | None)
    )


def _texts(value: Any) -> bool:
    return isinstance(value, list) and all(isinstance(text, str) for text in value)
