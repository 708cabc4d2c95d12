"""What each method did while it trained: the `dose` that records hold, from the trainer's own
counts. A method that hardly acted was hardly tested, whatever its difference."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from framework.report.parts.document import Block, Heading, Text, table
from framework.report.statistics.numbers import ABSENT
from framework.report.study.labels import outside
from framework.report.study.runs import ReportRun, Study

ACTED, ENOUGH = "acted_share", 0.5
HEADINGS = {
    "views_asked": "Epochs that asked for pseudo views",
    "views_made": "Pseudo views made",
    "refused_coverage": "Refused for coverage",
    "coverage_mean": "Mean coverage",
    "pseudo_share_of_loss": "Pseudo views' share of the loss",
    "share_dropped_mean": "Mean share dropped",
    ACTED: "Share of occasions acted on",
    "augment_acted_share": "of these, the augmenter's",
    "reg_acted_share": "of these, the regularizer's",
    "refused_other": "Refused for other reasons",
    "coverage_of_depth_mean": "Mean coverage of what depth covers",
    "support_distance_mean": "Mean distance of supports (camera spacings)",
    "nearest_mean": "Share of views asked for with the nearest photo as a support",
    "support_rank_mean": "Mean place of supports by nearness (1: the nearest photo)",
    "pseudo_share_of_views": "Pseudo views' share of the renders",
}
OWN = ("augment_acted_share", "reg_acted_share")
TEXT = "Counted during training, mean over the runs of a row; an empty cell was not counted."


def dose(study: Study) -> list[Block]:
    """A row per scene and method with a dose; no section where no record has one."""
    rows = []
    for scene in study.scenes:
        for method in study.methods:
            runs = [run for run in study.of(scene, method) if run.record.dose]
            if runs:
                place = {"Scene": scene} if len(study.scenes) > 1 else {}
                rows.append({**place, "Method": method, **_cells(runs)})
    if not rows:
        return []
    return [Heading(2, "What each method did"), table(rows, ("Scene", "Method")), Text(TEXT)]


def idle_sentence(study: Study) -> str:
    """Which methods acted on less than half of their occasions, and where; "" where none did."""
    hardly = _listed(study, some=False)
    partly = _listed(study, some=True)
    said = (
        f"Hardly tested, for it acted on less than half of its occasions: {hardly}."
        " A difference there says little about the method."
    )
    few = f"In some runs it acted on less than half of its occasions: {partly}."
    return " ".join(filter(None, (said if hardly else "", few if partly else "")))


def _listed(study: Study, some: bool) -> str:
    """`safi + none (12 % on SCENE)`: methods that hardly acted in all of a scene's runs together,
    or only in some of them."""
    told = []
    for method in study.methods:
        idle = [_idle(study.of(scene, method), scene, some) for scene in study.scenes]
        if any(idle):
            told.append(f"{method} ({', '.join(filter(None, idle))})")
    return "; ".join(told)


def _idle(runs: Sequence[ReportRun], scene: str, some: bool) -> str:
    """`12 % on SCENE`, the mean where that is little; or, for `some`, of the runs that hardly acted
    where the others make it more; "" where there is nothing to tell."""
    told = [run.record.dose[ACTED] for run in runs if ACTED in run.record.dose]
    shares = [_number(share) or 0.0 for share in told]  # in words where it was never asked
    few = [share for share in shares if share < ENOUGH]
    if not few or (float(np.mean(shares)) >= ENOUGH) != some:
        return ""
    if not some:
        return f"{100 * float(np.mean(shares)):.0f} % on {scene}"
    return f"{100 * float(np.mean(few)):.0f} % on {scene} in {len(few)} of {len(shares)} runs"


def _cells(runs: Sequence[ReportRun]) -> dict[str, str]:
    present = {key for run in runs for key in run.record.dose}
    if len(present & set(OWN)) == 1:  # which is the share of all occasions then
        present -= set(OWN)
    keys = [key for key in HEADINGS if key in present] + sorted(present - set(HEADINGS))
    return {_heading(key): _cell(runs, key) for key in keys}


def _heading(key: str) -> str:
    """`supports_mean` as `Mean supports`."""
    words = outside(key).replace("_", " ").strip()
    mean = f"Mean {words.removesuffix(' mean')}" if words.endswith(" mean") else words
    return HEADINGS.get(key, mean[:1].upper() + mean[1:])


def _cell(runs: Sequence[ReportRun], key: str) -> str:
    """The mean of numbers; else the distinct texts."""
    values = [run.record.dose[key] for run in runs if key in run.record.dose]
    numbers = [_number(value) for value in values]
    known = [number for number in numbers if number is not None]
    if known and len(known) == len(values):
        return _text(float(np.mean(known)))
    texts = dict.fromkeys(outside(str(value)) for value in values if value is not None)
    return ", ".join(texts) or ABSENT


def _text(mean: float) -> str:
    """A count as it is, else three digits."""
    return f"{mean:,.0f}" if mean.is_integer() or abs(mean) >= 100 else f"{mean:.3g}"


def _number(value: object) -> float | None:
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None
