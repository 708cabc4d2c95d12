"""How many Gaussians the methods of a study chose along a stress: does the model grow with what the
scene supports?"""

from __future__ import annotations

from framework.report.figures.stress import Panel, point
from framework.report.parts.chart import Chart, Series
from framework.report.parts.palette import looks
from framework.report.statistics.estimates import spread
from framework.report.study.runs import Study

SAME = 0.02  # sizes this near to each other are said to be the same


def chart(study: Study, panel: Panel, name: str) -> Chart | None:
    """Gaussians against the strength, with 95 % intervals over seeds; None where nothing is
    `told`."""
    if not told(panel):
        return None
    given = looks(study.methods)
    series = tuple(
        Series(
            method,
            given[method],
            tuple(point(level, counts) for level, counts in _counts(panel, method).items()),
        )
        for method in panel.runs
    )
    label = f"{panel.axis.label}; harder to the right"
    reverse = panel.axis.harder < 0
    return Chart(name, "", label, "Gaussians", series, reverse_x=reverse, dodge=True)


def told(panel: Panel) -> list[str]:
    """A sentence on every method; none where no method's number changes along the stress, or only
    that of the initialisation does, as every capacity is `fixed`."""
    if not _chosen(panel):
        return []
    means = {
        method: {level: spread(n).mean for level, n in _counts(panel, method).items()}
        for method in panel.runs
    }
    if not any(_changes(list(by_level.values())) for by_level in means.values()):
        return []
    return [f"{method}: {_sentence(panel, by_level)}." for method, by_level in means.items()]


def _chosen(panel: Panel) -> bool:
    runs = [run for by_level in panel.runs.values() for of in by_level.values() for run in of]
    return any(run.record.methods.get("capacity") != "fixed" for run in runs)


def _counts(panel: Panel, method: str) -> dict[float, list[float]]:
    """By level, the numbers of Gaussians of its runs."""
    by_level = panel.runs[method]
    return {
        level: [float(run.record.gaussians) for run in by_level[level]]
        for level in panel.levels
        if by_level.get(level)
    }


def _changes(means: list[float]) -> bool:
    return max(means) > (1 + SAME) * min(means)


def _sentence(panel: Panel, means: dict[float, float]) -> str:
    """From the hardest strength to the easiest."""
    levels = [level for level in reversed(panel.levels) if level in means]
    sizes = [means[level] for level in levels]
    if not _changes(sizes):
        return f"{sizes[-1]:,.0f} Gaussians at every strength"
    listed = " / ".join(f"{size:,.0f}" for size in sizes)
    values = " / ".join(f"{level:g}" for level in levels)
    return f"{listed} Gaussians at {panel.axis.at.format(values)}"
