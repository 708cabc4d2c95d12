"""Every method against its baseline, by scene and over all of them, as one forest plot."""

from __future__ import annotations

from dataclasses import replace

from framework.report.parts.forest import Forest, Row
from framework.report.parts.palette import looks
from framework.report.statistics.compare import Comparison, excludes_zero
from framework.report.statistics.estimates import Interval
from framework.report.statistics.outcomes import Outcomes
from framework.report.study.roles import marked
from framework.report.study.runs import Study

MIN_SPAN_DB = 0.5
MOST_ROWS = 60  # with more, scenes are left to the tables
CAPTION = (
    "Difference of test PSNR to the baseline, to the right: better. Thick bars: 95 % intervals that"
    " hold for all comparisons of a kind at once; a filled mark is really different from"
    " zero.{thin}"
)
THIN = (
    " `these scenes`: over the seeds; `scenes like these`: over the scenes, for what to expect on"
    " another one, filled where these scenes are too. Thin bars: a scene alone, 95 %"
    " each, not corrected: they show where a difference comes from and prove nothing."
)
CUT = " Scenes are not drawn one by one here: there are too many."


def forest(study: Study, found: Outcomes) -> tuple[Forest, str] | None:
    """With its caption; None where nothing was compared."""
    if not found.comparisons:
        return None
    several = bool(found.by_scene)
    of_scenes = sum(len(compared) for compared in found.by_scene.values())
    detailed = several and of_scenes + 2 * len(found.comparisons) <= MOST_ROWS
    given = looks(study.families)
    rows: list[Row] = []
    for method, c in found.comparisons.items():
        look = given[study.family_of[method]]
        if detailed:
            for scene, compared in found.by_scene.items():
                if method in compared:
                    label = marked(scene, study.name_of(scene))
                    rows.append(_row(compared[method], label, look, None))
        rows.append(
            _row(c, f"these {study.counted(c.scenes)}" if detailed else method, look, c.joint)
        )
        if detailed and c.like_joint is not None:
            row = _row(c, "scenes like these", look, c.like_joint)
            rows.append(replace(row, middle=c.like.mean if c.like else row.middle, real=c.general))
    bases = list(dict.fromkeys(c.baseline for c in found.comparisons.values()))
    against = bases[0] if len(bases) == 1 else "the baseline of the same budget"
    x_label = f"PSNR above {against} (dB)"
    caption = CAPTION.format(thin=THIN if detailed else CUT if several else "")
    return Forest("differences", against, x_label, tuple(rows), MIN_SPAN_DB), caption


def _row(c: Comparison, label: str, look: int, joint: Interval | None) -> Row:
    """joint: the corrected interval; None for a scene alone."""
    shown = c.interval if joint is None else joint
    low, high = (None, None) if shown is None else (shown.low, shown.high)
    return Row(
        c.method, label, look, c.difference, low, high, joint is not None, excludes_zero(joint)
    )
