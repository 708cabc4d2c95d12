"""What a study shows, as values: computed once per report, worded by the templates.

A difference is claimed where its interval excludes zero, and the interval is the one that the
charts draw: corrected for all comparisons of the report.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import numpy as np

from framework.report import stress
from framework.report.costs import Cheapest, Choice, cheapest, choices, one_machine
from framework.report.statistics.compare import Comparison, compare, corrected
from framework.report.statistics.estimates import Estimate, Interval
from framework.report.statistics.numbers import average
from framework.report.statistics.outcomes import (
    Outcomes,
    better_everywhere,
    by_pair,
    outcomes,
)
from framework.report.statistics.variance import SigmaComparison
from framework.report.study.baseline import baseline_commands
from framework.report.study.methods import PLAIN, Method
from framework.report.study.notes import without_psnr
from framework.report.study.plugins import papers
from framework.report.study.scenes import CHOSE, HELPED, TESTS, YOURS, role
from framework.report.study.study import ReportRun, Study

ACTED, ENOUGH = "acted_share", 0.5  # of a method's dose; a smaller share was hardly tested
T = TypeVar("T")


@dataclass(frozen=True)
class Verdict:
    """The recommendation.

    Attributes:
        kind: a branch of the macro `verdict`.
        method: the recommended method, or the only one.
        comparison: the recommended method compared with its baseline.
        others: methods that the reason names.
        spread: PSNR of the method, if the sentence names it.
    """

    kind: str
    method: Method = PLAIN
    comparison: Comparison | None = None
    others: tuple[Method, ...] = ()
    spread: Estimate | None = None


@dataclass(frozen=True)
class Contest:
    """A capacity compared with another one of the same method.

    Attributes:
        parameters, cpu: ratios of the sums over the paired runs; None if one lacks them.
    """

    method: Method
    comparison: Comparison
    parameters: float | None
    cpu: float | None


@dataclass(frozen=True)
class Idle:
    """A method, or a `part` of it, that acted on less than half of its opportunities."""

    method: Method
    scene: str
    part: str
    share: float
    n_idle: int
    n_runs: int


@dataclass(frozen=True)
class Findings:
    """The contents of a report apart from its tables."""

    study: Study
    outcomes: Outcomes
    panels: list[stress.Panel]
    limits: list[stress.Limit]

    @property
    def compared(self) -> list[Comparison]:
        """The comparisons of more than single runs."""
        return [c for c in self.outcomes.comparisons.values() if c.joint is not None]

    @property
    def significant(self) -> list[Comparison]:
        """Significant differences except that of the recommended method, the largest loss first."""
        clear = [c for c in self.compared if c.significant and c.method != self.outcomes.best]
        return sorted(clear, key=_difference)

    @property
    def unclear(self) -> list[Comparison]:
        """Differences that are not significant, the largest gain first."""
        return sorted((c for c in self.compared if not c.significant), key=_difference)[::-1]

    @cached_property
    def as_good(self) -> list[Comparison]:
        """Methods that do not differ significantly from a recommended method that is not the
        baseline.

        Tests are corrected for all other methods.
        """
        best, result = self.outcomes.best, self.outcomes.comparisons
        if best not in result or self.study.has_budgets or self.panels:
            return []
        values = {m: by_pair(self.study.of(method=m)) for m in (*self.outcomes.psnr, best)}
        others = [compare(m, values[m], best, values[best]) for m in values if m != best]
        comparable = [c for c in others if c is not None and c.joint is not None]
        tested = [replace(c, tests=len(comparable)) for c in comparable]
        # the verdict has the comparison with its own baseline, corrected for others
        alike = [c for c in tested if not c.significant and c.method != result[best].baseline]
        return sorted(alike, key=_difference)[::-1]

    @cached_property
    def verdict(self) -> Verdict:
        return _verdict(self.study, self.outcomes)

    @cached_property
    def contests(self) -> list[Contest]:
        return [] if self.panels else contests(self.study)

    @cached_property
    def choices(self) -> dict[str, list[Choice]]:
        """Scene -> which configuration to take for a given time."""
        return self._of_scenes(choices)

    @cached_property
    def cheapest(self) -> dict[str, Cheapest]:
        """Scene -> the cheapest configurations that are as good as the best."""
        return self._of_scenes(cheapest)

    def _of_scenes(self, answer: Callable[[Study, str], T | None]) -> dict[str, T]:
        scenes = [] if self.panels else self.study.tested
        answers = {scene: answer(self.study, scene) for scene in scenes}
        return {scene: value for scene, value in answers.items() if value}

    @property
    def advised_budgets(self) -> list[Choice]:
        """The choices by time of a single scene, for the verdict."""
        limited = any(run.method.limits for run in self.study.runs)
        if not limited or len(self.study.tested) != 1:
            return []
        family = self.outcomes.best.family
        every = next(iter(self.choices.values()))
        return [c for c in every if c.entry is None or c.entry.method.family == family]

    @property
    def timed(self) -> bool:
        """Whether some scene has advice by time."""
        scenes = self.study.tested
        return self.study.has_budgets and any(one_machine(self.study, s) for s in scenes)

    @cached_property
    def costed(self) -> list[Method]:
        """The methods to name the costs of: the advised one and its baseline, or the best other
        one. With several budgets these are the cheapest and the most expensive.
        """
        result = self.outcomes
        if not result.psnr:
            return []
        best = result.best
        methods = [best, self.study.baseline_of(best)]
        if self.study.has_budgets:
            family = [m for m in result.psnr if m.family == best.family]
            runs = {m: self.study.of(method=m) for m in family}
            cpu_s = {m: average([run.record.train_cpu_s for run in runs[m]]) for m in family}
            measured = sorted((m for m in family if cpu_s[m]), key=lambda m: cpu_s[m] or 0.0)
            return list(dict.fromkeys([measured[0], measured[-1]])) if measured else []
        if methods[0] == methods[1] and result.comparisons:
            comparisons = result.comparisons
            methods[1] = max(comparisons, key=lambda m: comparisons[m].difference)
        return list(dict.fromkeys(methods))

    @property
    def steadiness(self) -> list[SigmaComparison]:
        """Significant differences of the standard deviation over seeds."""
        return [c for c in self.outcomes.sigmas.values() if c.significant]

    @property
    def least_power(self) -> SigmaComparison | None:
        """The test of standard deviations with the least power; None without one."""
        return min(self.outcomes.sigmas.values(), key=lambda c: c.detectable or 0.0, default=None)

    @property
    def untuned_scenes(self) -> list[str]:
        """Tested scenes whose test photos chose no default."""
        return [s for s in self.study.tested if role(self.study.name_of(s)) != CHOSE]

    @property
    def roles(self) -> dict[str, list[str]]:
        """Role -> names of the tested scenes that have it."""
        names = list(dict.fromkeys(map(self.study.name_of, self.study.tested)))
        by_role = {r: [n for n in names if role(n) == r] for r in (CHOSE, HELPED, TESTS, YOURS)}
        return {r: result for r, result in by_role.items() if result}

    @cached_property
    def idle(self) -> list[Idle]:
        study = self.study
        cells = [(m, scene) for m in study.methods for scene in study.scenes]
        return [idle for m, scene in cells for idle in _idle(m, scene, study.of(scene, m))]

    @property
    def lost(self) -> int:
        """The number of runs of the recommended method that have no finite PSNR."""
        return without_psnr(self.study).get(self.outcomes.best, 0)

    @property
    def doubted(self) -> list[str]:
        """Scenes whose poses failed the check by stereo."""
        return sorted({run.scene for run in self.study.runs if run.poses_doubtful})

    @property
    def warned(self) -> list[str]:
        """Scenes whose runs gave warnings."""
        return sorted({run.scene for run in self.study.runs if run.record.warnings})

    @property
    def against(self) -> str:
        """What the gains of a stress are over."""
        several = any(limit.against != self.study.baseline for limit in self.limits)
        return "the baseline of the same options" if several else self.study.baseline.name

    @cached_property
    def baseline_commands(self) -> list[str]:
        """The commands that add plain training where the study lacks it, from the command lines of
        its runs."""
        return baseline_commands(self.study)

    @property
    def papers(self) -> list[str]:
        """Return the citations of the plugins and recipes that ran."""
        runs = self.study.runs
        chosen = {choice for run in runs for choice in run.record.methods.items()}
        recipes = {run.method.recipe.removesuffix("_sweep") for run in runs}
        return [*recipes, *(paper for choice in chosen for paper in papers(*choice))]


def find(study: Study) -> Findings:
    """The findings of a study."""
    panels = stress.panels(study)
    return Findings(study, outcomes(study), panels, stress.limits(study, panels))


def _difference(c: Comparison) -> float:
    return c.difference


def largest_effect(intervals: Iterable[Interval | None]) -> float:
    """The largest difference in dB that the intervals do not rule out."""
    return max(
        (max(-interval.low, interval.high) for interval in intervals if interval), default=0.0
    )


def _verdict(study: Study, outcomes: Outcomes) -> Verdict:
    if not study.runs:
        return Verdict("unfinished")
    if not study.tested:
        return Verdict("untested")
    if not outcomes.psnr:
        return Verdict("no psnr")
    highest = max(outcomes.psnr, key=lambda method: outcomes.psnr[method].mean)
    if len(study.methods) == 1:
        return Verdict("alone", highest, spread=outcomes.psnr[highest])
    of_highest = outcomes.comparisons.get(highest)
    if not outcomes.comparisons:
        return Verdict("no pairs", highest, spread=outcomes.psnr[highest])
    if study.has_plain and study.baseline not in outcomes.psnr:
        return Verdict("incomplete")
    if all(c.joint is None for c in outcomes.comparisons.values()):
        return Verdict("single runs", highest, of_highest, spread=outcomes.psnr[highest])
    if outcomes.best != study.baseline:
        return Verdict("gain", outcomes.best, outcomes.comparisons[outcomes.best])
    return _of_baseline(study, outcomes)


def _of_baseline(study: Study, outcomes: Outcomes) -> Verdict:
    """Why the baseline is advised."""
    gains = [c for c in outcomes.comparisons.values() if c.significant and c.difference > 0]
    over = [c for c in gains if c.baseline == study.baseline]
    complete = [c for c in over if better_everywhere(study, c)]
    if over:
        kind = "not over every baseline" if complete else "not on all scenes"
        return Verdict(kind, study.baseline, others=tuple(c.method for c in complete or over))
    if study.rival or (not study.has_plain and len(study.families) > 1):
        return Verdict("rival", study.baseline)
    return Verdict("own baselines" if gains else "baseline", study.baseline)


def contests(study: Study) -> list[Contest]:
    """Compare the capacities of every method that ran with several, each with the first one.

    Runs are paired by scene and seed, and tests are corrected for all of these comparisons.
    """
    groups: dict[Method, list[Method]] = {}
    for method in study.methods:
        groups.setdefault(method.without_capacity, []).append(method)
    pairs = [(other, first) for first, *others in groups.values() for other in others]
    by_method = {m: contest for m, base in pairs if (contest := _contest(study, m, base))}
    tested = corrected({method: contest.comparison for method, contest in by_method.items()})
    return [replace(contest, comparison=tested[method]) for method, contest in by_method.items()]


def _contest(study: Study, method: Method, base: Method) -> Contest | None:
    runs_of, other = study.of(method=method), study.of(method=base)
    names = {run.scene: run.scene_label.name for run in runs_of}
    comparison = compare(method, by_pair(runs_of), base, by_pair(other), names)
    if comparison is None:
        return None
    keys = by_pair(runs_of).keys() & by_pair(other).keys()
    pairs = [[run for run in runs if (run.scene, run.seed) in keys] for runs in (runs_of, other)]
    sizes = [sum(run.record.parameters for run in runs) for runs in pairs]
    seconds = [[run.record.train_cpu_s for run in runs] for runs in pairs]
    timed = all(None not in values for values in seconds)
    cpu, base_cpu = (sum(value or 0.0 for value in values) for values in seconds)
    return Contest(
        method.without_capacity,
        comparison,
        sizes[0] / sizes[1] if sizes[1] else None,
        cpu / base_cpu if timed and cpu and base_cpu else None,
    )


def _idle(method: Method, scene: str, runs: Sequence[ReportRun]) -> list[Idle]:
    """The parts of a method that acted too seldom on a scene; the whole if no part is named."""
    keys = sorted({key for run in runs for key in run.record.dose if key.endswith(f"_{ACTED}")})
    shares = [_share(method, scene, key, runs) for key in (keys if len(keys) > 1 else [])]
    idle = [one for one in shares if one is not None]
    whole = _share(method, scene, ACTED, runs)
    return idle or ([whole] if whole else [])


def _share(method: Method, scene: str, key: str, runs: Sequence[ReportRun]) -> Idle | None:
    """None where it acted enough in every run; a text in place of a share counts as never."""
    values = [run.record.dose[key] for run in runs if key in run.record.dose]
    shares = [float(v) if isinstance(v, int | float) else 0.0 for v in values]
    idle = [share for share in shares if share < ENOUGH]
    if not idle:
        return None
    part = key.removesuffix(ACTED).removesuffix("_")
    return Idle(method, scene, part, float(np.mean(idle)), len(idle), len(shares))
