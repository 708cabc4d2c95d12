"""A study that is a search: that no test view chose, and how every trial ended."""

from __future__ import annotations

from framework.metrics.values import LOWER, digits
from framework.records.search import Searched
from framework.report.parts.document import Block, Heading, Text, table
from framework.report.study.labels import code, outside
from framework.report.study.names import NAMES

HELD_OUT = (
    "Judged on training views that were held out (a split whose name ends in _held_out): no test"
    " view was trained on or looked at. These figures choose; they are no result."
)


def opening(searched: Searched) -> list[Block]:
    """For the first screen: the best options."""
    good = [trial for trial in searched.trials if trial.value is not None]
    if not good:
        return [Text("No trial of this search ended well.", "verdict")]
    sign = -1 if searched.metric in LOWER else 1
    best = max(good, key=lambda trial: sign * (trial.value or 0.0))
    places = digits(searched.metric)
    return [
        Text(
            f"Best of {len(searched.trials)} trials by {NAMES[searched.metric]}"
            f" ({best.value:.{places}f}): {code(' '.join(best.words))}.",
            "verdict",
        ),
        Text(
            "The best of many trials flatters itself: judge these options once, with several seeds,"
            " on scenes that chose nothing.",
            "note",
        ),
    ]


def trials(searched: Searched) -> list[Block]:
    """All trials, the best first, then those that failed."""
    sign = 1 if searched.metric in LOWER else -1
    rows = [
        {
            "Trial": str(trial.number),
            NAMES[searched.metric]: ""
            if trial.value is None
            else f"{trial.value:.{digits(searched.metric)}f}",
            "Options": code(" ".join(trial.words)),
            "Train CPU s": f"{trial.train_s:.1f}",
            "Run": code(trial.run) if trial.run else "",
            "Reason": outside(trial.error),
        }
        for trial in sorted(
            searched.trials,
            key=lambda t: (t.value is None, sign * (t.value or 0.0), t.number),
        )
    ]
    if not any(row["Reason"] for row in rows):
        rows = [{key: row[key] for key in row if key != "Reason"} for row in rows]
    text = f"The same in all: {code(' '.join(searched.fixed))}"
    return [Heading(2, "Trials"), Text(text), table(rows, ("Options", "Run", "Reason"))]
