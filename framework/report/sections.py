"""The report as a document. The first screen answers the study's question; all the rest is for who
wants to check.

What the first screen is depends on what varies: along a stress, where each method stops helping;
over budgets, which choice to take for a given time; else the table and its finding.
"""

from __future__ import annotations

from collections.abc import Sequence

from framework.report.figures import curves, modelsize, stress, tradeoff
from framework.report.figures.files import chart_picture
from framework.report.figures.images import draw_images, draw_sigma_maps
from framework.report.parts.document import Block, Bullets, Document, Heading, Picture, Text, table
from framework.report.statistics.outcomes import Outcomes, outcomes
from framework.report.study.collect import Study
from framework.report.study.labels import outside
from framework.report.text import capacities, gaps, tables
from framework.report.text.finding import sentence, sentences
from framework.report.text.provenance import provenance_blocks
from framework.report.text.published import PUBLISHED, SOURCE

WORDS = ("Scene", "Method", "Compared with", "Parameters", "Folder", "Capacity")
DEFINITIONS = (
    "PSNR, SSIM and FLIP: mean over the test views, then over seeds, from the saved 8-bit renders;"
    " ± is half the width of the 95 % interval of the mean over seeds (t). σ_PSNR: standard"
    " deviation (n − 1) over seeds of the mean PSNR over the test views{pooled}, in brackets its"
    " 95 % interval (χ², normal errors). Train: wall seconds of the training alone, mean over runs;"
    " CPU: of all its threads, which other programs disturb less."
    " Numbers are rounded to what their uncertainty supports."
)
POOLED = (
    f" (in the rows `{tables.ALL_SCENES}`: of its mean over the scenes; the other reading, the mean"
    " of the scenes' deviations, stands under Stability)"
)
BEST_BUDGETS = "Of each method, the budget with the highest mean PSNR on the scene."
HIDDEN = "No pictures of {scenes}: this report was built without photos, to be passed on."
NO_LPIPS = " LPIPS was not measured; the reason stands under Missing metrics."
LPIPS = (
    " LPIPS: of images in [−1, 1], as its authors define it; fed [0, 1]: what many papers print,"
    " and to be compared with nothing else."
)


def document(study: Study, title: str, visible: Sequence[str]) -> Document:
    """Everything the report says; draws its figures into `study.out_dir`, with pictures of the
    `visible` scenes."""
    found, panels = outcomes(study), stress.panels(study)
    between = [] if panels else capacities.contests(study)
    shown = stress.shown_scenes(study, panels)
    blocks: list[Block] = [Heading(1, outside(title))]
    if panels:
        blocks += _stress(study, panels)
    elif any(run.method_label.budget for run in study.runs):
        blocks += _budgets(study, found, between)
    else:
        blocks += _plain(study, found)
    blocks += [*gaps.failures(study), *gaps.missing_runs(study)]
    if not panels:  # the strengths of a stress share their seeds: no independent pairs
        blocks += [*_comparisons(found), *_capacities(between), *_stability(study, found)]
    blocks += _worst(study)
    blocks += _costs(study, [] if panels else study.scenes)
    blocks += _by_tag(study, shown)
    blocks += _pictures(study, shown, visible)
    if study.runs:
        blocks += [Heading(2, "Published figures"), PUBLISHED, Text(SOURCE)]
        blocks += [Heading(2, "Every run"), table(tables.seed_rows(study), WORDS)]
    blocks += [*gaps.missing_metrics(study), *provenance_blocks(study)]
    return Document(outside(title), tuple(blocks))


def _plain(study: Study, found: Outcomes) -> list[Block]:
    blocks: list[Block] = [Text(text, "finding") for text in sentences(study, found)]
    return [*blocks, *gaps.gap_notes(study), *_main_table(study)]


def _main_table(study: Study) -> list[Block]:
    if not study.runs:
        return []
    pooled = POOLED if len(study.scenes) > 1 else ""
    lpips = LPIPS if "lpips" in tables.measured(study) else NO_LPIPS
    rows = tables.main_rows(study, study.scenes)
    return [table(rows, WORDS), Text(DEFINITIONS.format(pooled=pooled) + lpips)]


def _budgets(study: Study, found: Outcomes, between: Sequence[capacities.Contest]) -> list[Block]:
    """What the first method's capacities are worth; advice and its chart for every scene; the
    table."""
    plain = [contest for contest in between if contest.method == between[0].method]
    blocks: list[Block] = []
    if plain:
        where = study.scenes[0] if len(study.scenes) == 1 else f"{len(study.scenes)} scenes"
        rivals = f"{plain[0].method} against {plain[0].against}"
        blocks = [Text(f"How many Gaussians, on {where}, {rivals}:", "finding")]
        blocks += [Bullets(tuple(capacities.sentences(plain)))]
    for scene in study.scenes:
        advice = tradeoff.advice(study, scene)
        if advice:
            clock = "CPU seconds" if study.by_cpu else "seconds"
            blocks += [Text(f"On {scene}, by {clock} of training:", "finding")]
            blocks += [Bullets(tuple(advice))]
        for charts in tradeoff.charts(study, scene)[:1]:
            alt = f"PSNR against training time of {scene}"
            blocks.append(chart_picture(study.out_dir, charts, alt, TRADEOFF_CAPTION))
    return [*blocks, Text(sentence(study, found)), *gaps.gap_notes(study), *_main_table(study)]


TRADEOFF_CAPTION = (
    "A line per method through its budgets that no other budget of the same method beats; faint:"
    " the beaten ones; ringed: the Pareto front of all methods. Bars: 95 % interval of the mean"
    " over seeds."
)
STRESS_CAPTION = (
    "Above: test PSNR against the strength; below: its difference to the baseline of the same seed."
    " Bars: 95 % interval of the mean over seeds; methods stand a little beside each other. The"
    " turning point is where the lower curve meets zero, interpolated linearly between tested"
    " strengths; its interval holds every strength where a paired t test does not refute zero."
)
SIZE_CAPTION = " Lowest: the number of Gaussians at the end of the training."


def _stress(study: Study, panels: Sequence[stress.Panel]) -> list[Block]:
    """The answer on every panel first, then the charts and tables."""
    limits = stress.limits(study, panels)
    answers: list[Block] = []
    details: list[Block] = []
    for panel in panels:
        told = tuple(stress.sentence(limit) for limit in limits if limit.panel is panel)
        if told:
            title = f"{panel.title}, along {panel.axis.label}, against {study.baseline}:"
            answers += [Text(title, "finding"), Bullets(told)]
        sizes = modelsize.told(panel)
        if sizes:
            title = f"Size of the model on {panel.title}, along {panel.axis.label}:"
            answers += [Text(title, "finding"), Bullets(tuple(sizes))]
        details.append(_stress_picture(study, panel))
        details.append(table(stress.rows(panel), WORDS))
    text = (
        "Cells: PSNR (dB), mean over seeds ± half the width of its 95 % interval (t). A method's"
        " difference is called significant if it is so at some strength, Bonferroni-corrected over"
        " the strengths, each method for itself."
    )
    return [*answers, *gaps.gap_notes(study, pooled=False), *details, Text(text)]


def _stress_picture(study: Study, panel: stress.Panel) -> Picture:
    alt = f"PSNR of {panel.title} against {panel.axis.label}"
    charts = stress.charts(study, panel)
    sizes = modelsize.chart(study, panel, stress.chart_name(panel))
    if sizes is None:
        return chart_picture(study.out_dir, charts, alt, STRESS_CAPTION)
    return chart_picture(study.out_dir, (*charts, sizes), alt, STRESS_CAPTION + SIZE_CAPTION)


def _comparisons(found: Outcomes) -> list[Block]:
    if not found.comparisons:
        return []
    text = (
        "Differences of runs paired by scene and seed; t interval and two-sided t test. The"
        " interval belongs to its row alone, the last column is corrected for all rows."
    )
    rows = tables.comparison_rows(found)
    return [Heading(2, "Comparisons"), table(rows, WORDS), Text(text)]


def _capacities(between: Sequence[capacities.Contest]) -> list[Block]:
    if not between:
        return []
    text = (
        "The same method with other ways to decide the number of Gaussians, paired by scene and"
        " seed, tests as above. Parameters and CPU time: multiples of what it is compared with."
    )
    return [Heading(2, "Between capacities"), table(capacities.rows(between), WORDS), Text(text)]


def _stability(study: Study, found: Outcomes) -> list[Block]:
    blocks: list[Block] = []
    if found.scene_sigma and any(s.sd is not None for s in found.psnr.values()):
        text = (
            "Two readings of σ_PSNR over several scenes. First: standard deviation (n − 1) over"
            " seeds of the mean over scenes, interval by χ². Second: mean over scenes of their"
            " standard deviations, each freed from its bias (c4); its interval takes the mean as a"
            " scaled χ with matched variance (Satterthwaite). Normal errors, scenes independent."
        )
        blocks += [table(tables.pooled_sigma_rows(found), WORDS), Text(text)]
    if found.sigmas:
        text = (
            "Ratio of the standard deviations over seeds. p: Brown–Forsythe test, which needs no"
            " normal errors and is conservative below about ten seeds. Interval: F distribution,"
            " normal errors, both samples independent; both are too cautious where a seed moves the"
            " two methods alike. Seeds needed: per method, for the two-sided F test at"
            " 5 % to find the observed ratio with a power of 80 %."
        )
        blocks += [table(tables.sigma_rows(found), WORDS), Text(text)]
    return [Heading(2, "Stability"), *blocks] if blocks else []


def _worst(study: Study) -> list[Block]:
    rows = tables.worst_rows(study)
    if not rows:
        return []
    limit = (
        ", or lies at least 1 dB below `none + none` of the same scene, budget and seed"
        if study.has_plain
        else " (the study has no `none + none` to compare with)"
    )
    text = (
        "Worst seed: lowest mean PSNR of a run. Worst view and 5th percentile: over the test views"
        " of all runs. A run counts as failed if it ended with an error, has no finite PSNR, ends"
        f" at least 1 dB below its own best evaluation{limit}; in brackets the 95 % interval of the"
        " share (Wilson)."
    )
    return [Heading(2, "Worst case"), table(rows, WORDS), Text(text)]


def _costs(study: Study, scenes: Sequence[str]) -> list[Block]:
    blocks: list[Block] = []
    has_budgets = any(run.method_label.budget for run in study.runs)
    for scene in scenes:
        own: list[Block] = [table(tradeoff.rows(study, scene), WORDS)]
        drawn = tradeoff.charts(study, scene)
        for charts in drawn[1:] if has_budgets else drawn:  # the first is on the first screen
            alt = f"PSNR against cost of {scene}"
            own.append(chart_picture(study.out_dir, charts, alt, TRADEOFF_CAPTION))
        if not has_budgets:
            own += [Bullets(tuple(tradeoff.advice(study, scene)))] if drawn else []
        least = tradeoff.smallest(study, scene)
        own += [Text(least)] if least else []
        blocks += [Heading(3, scene), *own]
    if not blocks:
        return []
    cpus = sorted({str(run.record.provenance.get("cpu")) for run in study.runs})
    text = (
        "Train: seconds of the training without its evaluations, by the wall clock and by the CPU"
        " time of all threads of the process, which other programs disturb less. Render: test views"
        f" per second. Machine: {'; '.join(map(outside, cpus))}. Pareto: no other has as much PSNR"
        " in as little time."
    )
    return [Heading(2, "Speed against accuracy"), *blocks, Text(text)]


def _by_tag(study: Study, scenes: Sequence[str]) -> list[Block]:
    rows = tables.tag_rows(study, scenes)
    return [Heading(2, "Kinds of test views apart"), table(rows, WORDS)] if rows else []


def _pictures(study: Study, scenes: Sequence[str], visible: Sequence[str]) -> list[Block]:
    seen = [scene for scene in scenes if scene in visible]
    drawn = {
        "Images": [(scene, draw_images(study, scene)) for scene in seen],
        "Where runs disagree": [(scene, draw_sigma_maps(study, scene)) for scene in seen],
        "Quality over training time": [(scene, _curves(study, scene)) for scene in scenes],
    }
    hidden = [scene for scene in study.scenes if scene not in visible]
    blocks: list[Block] = []
    if hidden:
        blocks = [Heading(2, "Pictures left out"), Text(HIDDEN.format(scenes=", ".join(hidden)))]
    of_many = any(run.method_label.budget for run in study.runs)
    for heading, pictures in drawn.items():
        present = [(scene, picture) for scene, picture in pictures if picture is not None]
        if present:
            blocks += [Heading(2, heading), *([Text(BEST_BUDGETS)] if of_many else [])]
            blocks += [block for s, picture in present for block in (Heading(3, s), picture)]
    return blocks


def _curves(study: Study, scene: str) -> Picture | None:
    chart = curves.chart(study, scene)
    if chart is None:
        return None
    alt = f"Quality over training time of {scene}"
    return chart_picture(study.out_dir, (chart,), alt, curves.caption(study, scene))
