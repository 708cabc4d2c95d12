"""How much a method's gain depends on the choice of training photos.

The evidence comes from studies over draws of the training photos of a scene
(`scene.split=NAME_drawn0,NAME_drawn1,...`) with fixed test photos. A draw's gain is the mean over
its seeds of method minus baseline, with the same seed in both. The t interval of the mean gain over
draws is what other photos of the same scene would give. A one-way analysis of variance tests
whether draws differ by more than seeds do.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special  # without scipy.stats, which takes a second to import

from framework.report.statistics.estimates import Estimate, estimate
from framework.report.study.methods import Method
from framework.report.study.study import ReportRun, Study
from framework.scenes import DRAWN


@dataclass(frozen=True)
class Variance:
    """One-way analysis of variance of groups.

    Attributes:
        f: variance between groups over that within groups.
        between, within: degrees of freedom.
        sd: standard deviation within a group.
        p: probability of such an f for equal groups; None if nothing varies.
    """

    f: float
    between: int
    within: int
    sd: float
    p: float | None


@dataclass(frozen=True)
class Draws:
    """`method` minus `baseline` in dB on a scene under fixed conditions.

    Attributes:
        differences: draw -> differences of its seeds.
        plain: draw -> mean PSNR of the baseline.
        over: the mean over draws.
        alike: analysis of variance of the draws with two or more seeds; None for fewer than two.
    """

    scene: str
    method: Method
    baseline: Method
    differences: Mapping[str, tuple[float, ...]]
    plain: Mapping[str, float]
    over: Estimate
    alike: Variance | None

    @property
    def gains(self) -> list[float]:
        """The mean over seeds of each draw."""
        return [float(np.mean(values)) for values in self.differences.values()]


def draws(study: Study) -> list[Draws]:
    """Compare every method with its baseline over the draws of every scene that has at least two.

    All other conditions of the scene are fixed.
    """
    groups: dict[tuple[str, str], list[ReportRun]] = defaultdict(list)
    for run in study.runs:
        if DRAWN in _draw(run):
            options = {k: v for k, v in run.record.config["scene"].items() if k != "split"}
            label = run.scene_label
            fixed = repr(sorted((options | dict(label.data)).items()))
            groups[label.without("split"), fixed].append(run)
    results = [
        _draws(name, method, study.baseline_of(method), runs)
        for (name, _), runs in groups.items()
        for method in study.methods
        if study.baseline_of(method) != method
    ]
    return [d for d in results if d is not None]


def _draws(scene: str, method: Method, baseline: Method, runs: Sequence[ReportRun]) -> Draws | None:
    of_method, base = (_by_draw(runs, one) for one in (method, baseline))
    differences = {}
    for draw in of_method:
        seeds = sorted(of_method[draw].keys() & base.get(draw, {}).keys())
        if seeds:
            differences[draw] = tuple(of_method[draw][seed] - base[draw][seed] for seed in seeds)
    if len(differences) < 2:
        return None
    over = estimate([float(np.mean(values)) for values in differences.values()])
    plain = {draw: float(np.mean(list(base[draw].values()))) for draw in differences}
    alike = variance([values for values in differences.values() if len(values) > 1])
    return Draws(scene, method, baseline, differences, plain, over, alike)


def _by_draw(runs: Sequence[ReportRun], method: Method) -> dict[str, dict[int, float]]:
    """Draw, in the order of their numbers -> seed -> PSNR."""
    by_draw: dict[str, dict[int, float]] = defaultdict(dict)
    for run in runs:
        psnr = run.mean("psnr")
        if run.method == method and psnr is not None:
            by_draw[_draw(run)][run.seed] = psnr
    return {draw: by_draw[draw] for draw in sorted(by_draw, key=lambda d: (len(d), d))}


def _draw(run: ReportRun) -> str:
    """The rule by which the run's photos were shared out."""
    return str(run.record.config["scene"].get("split"))


def variance(groups: Sequence[Sequence[float]]) -> Variance | None:
    """Analyse groups of two or more values; None for fewer than two groups."""
    if len(groups) < 2:
        return None
    every = np.concatenate([np.asarray(group, dtype=np.float64) for group in groups])
    means = [float(np.mean(group)) for group in groups]
    between, within = len(groups) - 1, len(every) - len(groups)
    among = sum(len(g) * (m - float(every.mean())) ** 2 for g, m in zip(groups, means, strict=True))
    inside = sum(
        float(np.square(np.subtract(g, m)).sum()) for g, m in zip(groups, means, strict=True)
    )
    sd = math.sqrt(inside / within)
    if inside == 0:
        return Variance(math.inf if among > 0 else 0.0, between, within, sd, None)
    f = (among / between) / (inside / within)
    return Variance(f, between, within, sd, float(special.fdtrc(between, within, f)))
