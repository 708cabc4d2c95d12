"""The first screen: the verdict, then the one figure that shows it.

What that is depends on what varies: along a stress, where each method helps; over budgets, which
choice to take for a given time; else who is better than the baseline.
"""

from __future__ import annotations

from collections.abc import Sequence

from framework.report.figures import modelsize, stress, tradeoff
from framework.report.figures.files import chart_picture, forest_picture
from framework.report.figures.forest import forest
from framework.report.parts.document import Block, Bullets, Heading, Picture, Text, table
from framework.report.statistics.outcomes import Outcomes
from framework.report.study.labels import listed
from framework.report.study.roles import roles_sentence
from framework.report.study.runs import Study
from framework.report.text import budgets, capacities, gaps
from framework.report.text.dose import idle_sentence
from framework.report.verdict import lead, limits, points
from framework.report.verdict.steady import steady_sentence

TRADEOFF_CAPTION = (
    "A line per method through its budgets that no other budget of the same method beats; faint:"
    " the beaten ones. Ringed: the cheapest, and what is shown to pay, as really better than"
    " every cheaper ringed one (paired t test, corrected). Bars: 95 % interval of the"
    " mean over seeds, of each alone. The axis shows at least 1 dB."
)
STRESS_CAPTION = (
    "Above: test PSNR against the strength, bars: 95 % interval of the mean over seeds. Below: its"
    " difference to the baseline of the same seed, bars: 95 % intervals that hold for all strengths"
    " and methods at once, as the sentences do. Methods stand a little beside each other. The"
    " turning point is where the lower curve meets zero, interpolated linearly between tested"
    " strengths; its interval holds every strength where a paired t test does not refute zero."
)
STRESS_TEXT = (
    "Cells: PSNR (dB), mean over seeds ± half the width of its 95 % interval (t). A method is said"
    " to help or to cost at a strength where its corrected interval excludes zero; the correction"
    " is over all strengths, methods and charts of the report."
)
SIZE_CAPTION = " Lowest: the number of Gaussians at the end of the training."


def plain(study: Study, found: Outcomes) -> list[Block]:
    """The verdict and the forest plot."""
    return [*_verdict(study, found), *gaps.gap_notes(study), *_forest(study, found)]


def over_budgets(
    study: Study, found: Outcomes, between: Sequence[capacities.Contest]
) -> list[Block]:
    """The verdict; what the first method's capacities are worth; advice by time for every scene and
    its chart; the forest plot."""
    first = [contest for contest in between if contest.method == between[0].method]
    beside = capacities.in_verdict(first)
    blocks = [*_verdict(study, found, budgets.in_verdict(study), beside)]
    if first:
        where = study.tested[0] if len(study.tested) == 1 else study.counted(study.tested)
        rivals = f"{first[0].method} against {first[0].against}"
        how = capacities.evidence(first)
        blocks += [Text(f"How many Gaussians, on {where}, {rivals}{how}:", "finding")]
        blocks += [Bullets(tuple(capacities.sentences(first)))]
    for scene in study.scenes:
        advice = budgets.advice(study, scene)
        if advice:
            clock = "CPU seconds" if study.by_cpu else "seconds"
            blocks += [Text(f"On {scene}, by {clock} of training:", "finding")]
            blocks += [Bullets(tuple(advice))]
    blocks += gaps.gap_notes(study)
    for scene in study.scenes:
        for charts in tradeoff.charts(study, scene)[:1]:
            alt = f"PSNR against training time of {scene}"
            blocks.append(chart_picture(study.out_dir, charts, alt, TRADEOFF_CAPTION))
    return [*blocks, *_forest(study, found)]


def along_stress(study: Study, panels: Sequence[stress.Panel], outcomes: Outcomes) -> list[Block]:
    """The verdict, the answer on every panel, then the charts and tables."""
    found = stress.limits(study, panels)
    if len(study.methods) == 1:
        said, behind = limits.alone(panels, study.baseline), []
    else:
        steady = steady_sentence(outcomes)  # of a seed's mean over the strengths
        said = limits.verdict(found, lead.plainly(study.baseline))
        behind = limits.behind(found, steady)
    blocks: list[Block] = [Text(said + _caution(study), "verdict")]
    ends = [limits.weakest(panel, study.baseline, points.cost_of) for panel in panels]
    told = [text for text in (*behind, *ends) if text]
    blocks += [Bullets(tuple(told))] if told else []
    said_of, details = _courses(study, panels, found)
    blocks += said_of
    beside = [text for text in (idle_sentence(study), _roles(study)) if text]
    blocks += [Text(text) for text in beside]
    return [*blocks, *gaps.gap_notes(study, pooled=False), *details, Text(STRESS_TEXT)]


def stress_beside(study: Study) -> list[Block]:
    """The stresses of a study that has other scenes too, as a section of its own."""
    panels = stress.panels_beside(study)
    if not panels:
        return []
    said_of, details = _courses(study, panels, stress.limits(study, panels))
    return [Heading(2, "Along a stress"), *said_of, *details, Text(STRESS_TEXT)]


def _courses(
    study: Study, panels: Sequence[stress.Panel], found: Sequence[stress.Limit]
) -> tuple[list[Block], list[Block]]:
    """Of every panel what is said of it, and its chart and table."""
    blocks: list[Block] = []
    details: list[Block] = []
    against = stress.compared_with(study, found)
    for panel in panels:
        courses = tuple(limits.sentence(limit) for limit in found if limit.panel is panel)
        if courses:
            title = f"{panel.title}, along {panel.axis.label}, against {against}:"
            blocks += [Text(title, "finding"), Bullets(courses)]
        sizes = modelsize.told(panel)
        if sizes:
            title = f"Size of the model on {panel.title}, along {panel.axis.label}:"
            blocks += [Text(title, "finding"), Bullets(tuple(sizes))]
        details += [_stress_picture(study, panel, found), table(stress.rows(panel), ("Method",))]
    return blocks, details


def _verdict(study: Study, found: Outcomes, budget: str = "", beside: str = "") -> list[Block]:
    said = [*points.points(study, found, beside), idle_sentence(study), _roles(study)]
    told = tuple(text for text in said if text)
    blocks: list[Block] = [Text(lead.lead(study, found, budget) + _caution(study), "verdict")]
    blocks += [Bullets(told)] if told else []
    how = points.evidence(found)
    return [*blocks, *([Text(how)] if how else [])]


def _caution(study: Study) -> str:
    """A sentence that names the scenes whose poses failed the check by stereo, or the scenes whose
    runs gave other warnings."""
    doubted = sorted({run.scene for run in study.runs if run.poses_doubtful})
    if doubted:
        return f" Caution: the poses do not seem to fit the photos of {listed(doubted, 'and')}."
    warned = sorted({run.scene for run in study.runs if run.record.warnings})
    return f" Caution: see the warnings about {listed(warned, 'and')} below." if warned else ""


def _roles(study: Study) -> str:
    if not study.tested:
        return ""
    return roles_sentence(list(dict.fromkeys(map(study.name_of, study.tested))))


def _forest(study: Study, found: Outcomes) -> list[Block]:
    drawn = forest(study, found)
    if drawn is None:
        return []
    plot, caption = drawn
    alt = f"Differences of PSNR to {plot.against} with their intervals"
    return [forest_picture(study.out_dir, plot, alt, caption)]


def _stress_picture(study: Study, panel: stress.Panel, found: Sequence[stress.Limit]) -> Picture:
    alt = f"PSNR of {panel.title} against {panel.axis.label}"
    charts = stress.charts(study, panel, found)
    sizes = modelsize.chart(study, panel, panel.file)
    if sizes is None:
        return chart_picture(study.out_dir, charts, alt, STRESS_CAPTION)
    return chart_picture(study.out_dir, (*charts, sizes), alt, STRESS_CAPTION + SIZE_CAPTION)
