"""The sections for who wants to check: results, comparisons, spread, worst cases, cost."""

from __future__ import annotations

from collections.abc import Sequence

from framework.report.figures import tradeoff
from framework.report.figures.files import chart_picture
from framework.report.opening import TRADEOFF_CAPTION
from framework.report.parts.document import Block, Bullets, Heading, Text, table
from framework.report.statistics.outcomes import Outcomes
from framework.report.statistics.variance import SigmaComparison
from framework.report.study.labels import listed, outside
from framework.report.study.runs import Study
from framework.report.text import budgets, capacities, comparisons, tables

WORDS = ("Scene", "Method", "Compared with", "Parameters", "Folder", "Capacity", "View", "Video")
DEFINITIONS = (
    "PSNR, SSIM and FLIP: mean over the test views, then over seeds, from the saved 8-bit renders;"
    " ± is half the width of the 95 % interval of the mean over seeds (t). σ_PSNR: standard"
    " deviation (n − 1) over seeds of the mean PSNR over the test views{pooled}, in brackets its"
    " 95 % interval (χ², normal errors). A mean with (n = …) behind"
    " it is of so many seeds: the others were not measured. "
)
TIMES = (
    "Train: wall seconds of the training alone, mean over runs; CPU: of all its threads, which"
    " other programs disturb less."
    " Numbers are rounded to what their uncertainty supports."
)
POOLED = (
    f" (in the rows `{tables.ALL_SCENES}`: of its mean over the scenes; the other reading, the mean"
    " of the scenes' deviations, stands under Stability)"
)
NO_LPIPS = " LPIPS was not measured; the reason stands under Missing metrics."
LPIPS = (
    " LPIPS: of images in [−1, 1], as its authors define it; fed [0, 1]: what many papers print,"
    " and to be compared with nothing else."
)
COMPARISONS = (
    "Runs paired by scene and seed; t intervals and two-sided t test. These scenes: a seed's"
    " differences are averaged over the scenes first, as its runs share draws, and the interval is"
    " over seeds. {like}All intervals and p are corrected for {tests}"
    " (Bonferroni). The same as LaTeX, and every scene alone: `comparisons.tex`."
)
LIKE = (
    "Scenes like these: a scene's differences are averaged over its seeds first, and the interval"
    " is over scenes, for what to expect on another scene of the kind. Conditions of one scene, as"
    " other photos of it, are averaged too: they count as one. "
)
DEVIATIONS = (
    "Standard deviation (n − 1) over seeds. Its intervals: by χ², for normal errors; and by a"
    " studentised bootstrap of its logarithm, from five seeds on. With heavy-tailed errors (t, 3"
    " degrees of freedom) the first covers the truth 85 % of the time with 5 seeds and 67 % with"
    " 20, the second 97 % and 84 %."
)
BOTH_READINGS = (
    " Mean of the scenes' σ: each freed from its bias (c4); the interval takes the mean as a scaled"
    " χ with matched variance (Satterthwaite), normal errors, scenes independent."
)
RATIOS = (
    "Ratio of the standard deviations over seeds. {test} Interval: of the row alone, normal"
    " errors: the ratios that the test of values does not refute. Found 8 times in 10 below: the"
    " ratio that this test would have found with these seeds; –: none, however small. Seeds needed:"
    " per method, for this test to find the observed ratio 8 times in 10. Both are simulated with"
    " normal errors, to about a tenth, with r taken as 0.995 at most, and hold for the corrected"
    " test."
)
PAIRED = (
    "p: Pitman–Morgan test of pairs, as a seed moves both methods (r: how alike), of values and of"
    " ranks, the larger p, corrected for {tests}. With normal errors it errs at most as often as it"
    " says; with heavy-tailed ones (t, 3 degrees of freedom) at 5 % in {sizes} of studies without a"
    " difference (simulated)."
)
FEW, STILL = "the methods share too few seeds", "one of them does not vary"
INDEPENDENT = (
    "p: Brown–Forsythe test, as {why}, corrected for {tests}; at 5 % it"
    " errs in {sizes} of studies without a difference (simulated, normal errors)."
)


def main_table(study: Study) -> list[Block]:
    """Every method on every scene and over all."""
    if not study.runs:
        return []
    pooled = POOLED if len(study.tested) > 1 else ""
    lpips = LPIPS if "lpips" in tables.measured(study) else NO_LPIPS
    rows = tables.main_rows(study, study.scenes)
    text = DEFINITIONS.format(pooled=pooled) + TIMES + lpips if study.tested else TIMES
    return [Heading(2, "Results"), table(rows, WORDS), Text(text)]


def compared(found: Outcomes) -> list[Block]:
    """Every method against its baseline."""
    if not found.comparisons:
        return []
    like = LIKE if any(c.like for c in found.comparisons.values()) else ""
    tests = max(c.tests for c in found.comparisons.values())
    rows = comparisons.comparison_rows(found)
    text = COMPARISONS.format(like=like, tests=_tests(tests))
    return [Heading(2, "Comparisons"), table(rows, WORDS), Text(text)]


def between_capacities(between: Sequence[capacities.Contest]) -> list[Block]:
    """Ways to decide the number of Gaussians."""
    if not between:
        return []
    text = (
        "The same method with other ways to decide the number of Gaussians, paired by scene and"
        " seed, tests as above. Parameters and CPU time: multiples of what it is compared with."
    )
    return [Heading(2, "Between capacities"), table(capacities.rows(between), WORDS), Text(text)]


def stability(found: Outcomes) -> list[Block]:
    """Spread over seeds: of every method, and against the baseline's."""
    blocks: list[Block] = []
    if any(s.sd is not None for s in found.psnr.values()):
        text = DEVIATIONS + (BOTH_READINGS if found.scene_sigma else "")
        blocks += [table(comparisons.deviation_rows(found), WORDS), Text(text)]
    if found.sigmas:
        text = RATIOS.format(test=_of_sigmas(list(found.sigmas.values())))
        blocks += [table(comparisons.sigma_rows(found), WORDS), Text(text)]
    return [Heading(2, "Stability"), *blocks] if blocks else []


def _of_sigmas(found: Sequence[SigmaComparison]) -> str:
    """Which tests were used, and how often they err."""
    said = []
    for words, own in (
        (PAIRED, [c for c in found if c.paired]),
        (INDEPENDENT, [c for c in found if not c.paired]),
    ):
        sizes = {(c.n, c.other_n): c.size for c in own}
        told = ", ".join(
            f"{100 * share:.1f} % (with {n if n == m else f'{n} and {m}'} seeds)"
            for (n, m), share in sorted(sizes.items())
        )
        whys = dict.fromkeys(FEW if c.ratio is not None else STILL for c in own)
        why = listed(list(whys), "or") if own else ""
        said += [words.format(tests=_tests(len(found)), sizes=told, why=why)] if own else []
    return " ".join(said)


def worst(study: Study) -> list[Block]:
    """The worst seed and view, and how often a run fails."""
    rows = tables.worst_rows(study)
    if not rows or not study.has_views:
        return []
    limit = (
        ", or lies at least 1 dB below `none + none` of the same scene, budget and seed"
        if study.without_rival.has_plain
        else " (the study has no `none + none` to compare with)"
    )
    text = (
        "Worst seed: lowest mean PSNR of a run. Worst view and 5th percentile: over the test views"
        " of all runs. A run counts as failed if it ended with an error, has no finite PSNR, ends"
        f" at least 1 dB below its own best evaluation{limit}; in brackets the 95 % interval of the"
        " share (Wilson)."
    )
    return [Heading(2, "Worst case"), table(rows, WORDS), Text(text)]


def costs(study: Study, scenes: Sequence[str]) -> list[Block]:
    """What every method costs on these scenes, with its charts."""
    blocks: list[Block] = []
    for scene in scenes:
        own: list[Block] = [table(budgets.rows(study, scene), WORDS)]
        drawn = tradeoff.charts(study, scene)
        for charts in drawn[1:] if study.has_budgets else drawn:  # the first is on the first screen
            alt = f"PSNR against cost of {scene}"
            own.append(chart_picture(study.out_dir, charts, alt, TRADEOFF_CAPTION))
        if not study.has_budgets:
            own += [Bullets(tuple(budgets.advice(study, scene)))] if drawn else []
        least = budgets.smallest(study, scene)
        own += [Text(least)] if least else []
        blocks += [Heading(3, scene), *own]
    if not blocks:
        return []
    cpus = sorted({str(run.record.provenance.get("cpu", "not told")) for run in study.runs})
    text = (
        "Train: seconds of the training without its evaluations, by the wall clock and by the CPU"
        " time of all threads of the process, which other programs disturb less. Render: test views"
        f" per second. Machine: {'; '.join(map(outside, cpus))}. More time pays: `yes` where a"
        " method is really better than the one so marked before it, beginning with the cheapest"
        " (paired t test, corrected for all others there); `not shown`, where that may be chance or"
        " nothing is gained."
    )
    # first: what follows a scene's heading is that scene's, and hidden or folded with it
    return [Heading(2, "Speed against accuracy"), Text(text), *blocks]


def by_tag(study: Study, scenes: Sequence[str]) -> list[Block]:
    """Views between the training cameras and views beyond them."""
    rows = tables.tag_rows(study, scenes)
    return [Heading(2, "Kinds of test views apart"), table(rows, WORDS)] if rows else []


def _tests(n: int) -> str:
    return "one comparison" if n == 1 else f"{n} comparisons"
