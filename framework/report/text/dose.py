"""What each method did while it trained: the `dose` that records hold, from the trainer's own
counts. A method that hardly acted was hardly tested, whatever its difference."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from framework.report.parts.document import Block, Heading, Text, table
from framework.report.statistics.numbers import ABSENT
from framework.report.study.labels import outside
from framework.report.study.runs import ReportRun, Study

Share = tuple[str, str]  # what is told of a share, before and after the scenes where it is so
ACTED, ENOUGH = "acted_share", 0.5
HEADINGS = {
    "views_asked": "Epochs that asked for pseudo views",
    "views_made": "Pseudo views made",
    "refused_coverage": "Refused for coverage",
    "coverage_mean": "Mean coverage",
    "pseudo_share_of_loss": "Pseudo views' share of the loss",
    "share_dropped_mean": "Mean share dropped",
    ACTED: "Share of occasions acted on (of several parts the least active one's)",
    "augment_acted_share": "The augmenter's share",
    "reg_acted_share": "The regularizer's share",
    "refused_other": "Refused for other reasons",
    "coverage_of_depth_mean": "Mean coverage of what depth covers",
    "support_distance_mean": "Mean distance of supports (camera spacings)",
    "nearest_mean": "Share of views asked for with the nearest photo as a support",
    "support_rank_mean": "Mean place of supports by nearness (1: the nearest photo)",
    "pseudo_share_of_views": "Pseudo views' share of the renders",
}
OWN = ("augment_acted_share", "reg_acted_share")
PARTS = dict(zip(OWN, ("augmenter", "regularizer"), strict=True))
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
    """Which methods, or parts of them, acted on less than half of their occasions, and where; ""
    where none did."""
    hardly, parts, partly = (_listed(study, told) for told in (_hardly, _parts, _partly))
    said = (
        f"Hardly tested, for it acted on less than half of its occasions: {hardly}."
        " A difference there says little about the method."
    )
    some = f"A part that acted on less than half of its occasions was hardly tested: {parts}."
    few = f"In some runs it acted on less than half of its occasions: {partly}."
    found = ((said, hardly), (some, parts), (few, partly))
    return " ".join(text for text, named in found if named)


def _listed(study: Study, told: Callable[[Sequence[ReportRun]], Sequence[Share]]) -> str:
    """`safi + none (12 % on SCENE and SCENE)`: the methods of which there is something to tell."""
    found = []
    for method in study.methods:
        where: dict[Share, list[str]] = {}
        for scene in study.scenes:
            for share in told(study.of(scene, method)):
                where.setdefault(share, []).append(scene)
        if where:
            own = (f"{text} on {study.listed(at)}{runs}" for (text, runs), at in where.items())
            found.append(f"{method} ({', '.join(own)})")
    return "; ".join(found)


def _hardly(runs: Sequence[ReportRun]) -> list[Share]:
    """`12 %`: the mean share, where that of every part is little."""
    share, parts = _share(runs, ACTED), _part_shares(runs)
    little = share is not None and share < ENOUGH
    if not little or any(own >= ENOUGH for own in parts.values()):
        return []
    return [(_percent(share or 0.0), "")]


def _parts(runs: Sequence[ReportRun]) -> list[Share]:
    """`occlusion: 0 %`: of the parts those that hardly acted, where others did."""
    parts = _part_shares(runs)
    idle = {part: own for part, own in parts.items() if own < ENOUGH}
    if len(idle) == len(parts):
        return []
    return [(f"{part}: {_percent(own)}", "") for part, own in idle.items()]


def _partly(runs: Sequence[ReportRun]) -> list[Share]:
    """`12 %` and `in 1 of 3 runs`, where neither the mean nor that of a part is little."""
    shares = _shares(runs, ACTED)
    few = [share for share in shares if share < ENOUGH]
    if not few or _hardly(runs) or _parts(runs):
        return []
    return [(_percent(float(np.mean(few))), f" in {len(few)} of {len(shares)} runs")]


def _part_shares(runs: Sequence[ReportRun]) -> dict[str, float]:
    """The mean share of every part's occasions, by its name; empty of a method of one part."""
    keys = {key for run in runs for key in run.record.dose if key.endswith(f"_{ACTED}")}
    if len(keys) < 2:
        return {}
    means = {key: _share(runs, key) or 0.0 for key in sorted(keys)}
    return {PARTS.get(k, outside(k.removesuffix(f"_{ACTED}"))): mean for k, mean in means.items()}


def _share(runs: Sequence[ReportRun], key: str) -> float | None:
    shares = _shares(runs, key)
    return float(np.mean(shares)) if shares else None


def _shares(runs: Sequence[ReportRun], key: str) -> list[float]:
    """Of the runs that counted it; 0 where a word says that it was never asked."""
    told = [run.record.dose[key] for run in runs if key in run.record.dose]
    return [_number(share) or 0.0 for share in told]


def _percent(share: float) -> str:
    """What is less than half is not told as half."""
    rounded = f"{100 * share:.0f}"
    return f"{min(100 * share, 49.9):.1f} %" if rounded == "50" else f"{rounded} %"


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
