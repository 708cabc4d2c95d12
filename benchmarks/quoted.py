"""Numbers inside the sentences of README and docs, from the records of committed studies.

    SAFI gains <!-- = gain("paper_fern", "SAFI") -->0.45 dB (0.19 to 0.70)<!-- --> on fern.

A mark holds a Jinja expression. Its value follows, up to a closing mark. Pages do not show marks
when they are rendered. Expressions may use the functions of `LANGUAGE`. Methods have the name of
the report or of the command line. The statistics are those of `framework.report`.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import pandas as pd
from jinja2 import Environment, StrictUndefined, TemplateError

from fishersplat import UserError, load_study
from framework.report.findings import Findings, find, largest_effect
from framework.report.statistics.estimates import Interval
from framework.report.statistics.numbers import format_significant
from framework.report.study.collect import collect
from framework.report.study.methods import Method

ROOT = Path(__file__).resolve().parent.parent
COMMITTED = ROOT / "reports" / "committed"
MARK = re.compile(r"<!-- = ([^|\n]+?) -->([^\n]*?)<!-- -->")
FIRST = re.compile(r"[\s>*-]*<!-- = ")  # at the start of a line a comment ends the paragraph
T = TypeVar("T")
UNTUNED, OTHERS = "untuned", "others"  # `on`: scenes that chose no default; scenes like these


@dataclass(frozen=True)
class Gain:
    """A difference in dB with its interval."""

    mean: float
    interval: Interval | None
    corrected: bool

    def __neg__(self) -> Gain:
        inside = self.interval
        turned = None if inside is None else Interval(-inside.high, -inside.low)
        return Gain(-self.mean, turned, self.corrected)

    def __str__(self) -> str:
        return f"{self.db} ({self.span}{'' if self.corrected else ', uncorrected'})"

    @property
    def db(self) -> str:
        """The difference alone, as `0.86 dB`."""
        return f"{_decimals(self.mean)} dB"

    @property
    def span(self) -> str:
        """The interval, as `0.60 to 1.13`; an end that would round to zero keeps its sign."""
        if self.interval is None:
            raise ValueError("expected several seeds or scenes, got an interval of one")
        ends = (self.interval.low, self.interval.high)
        low, high = (_decimals(e) if abs(e) >= 0.005 else format_significant(e, 1) for e in ends)
        return f"{low} to {high}"


def gain(study: str, method: str, over: str = "", on: str = "", corrected: bool = True) -> Gain:
    """The gain in PSNR of a method.

    Args:
        over: the method that it is compared with; by default the baseline.
        on: one of the study's scenes, as in a study of this scene alone; `untuned`: the scenes that
            chose no default; `others`: other scenes like those of the study.
        corrected: for all comparisons of the study, or of its scene.
    """
    outcomes = _findings(study, over, "" if on in (UNTUNED, OTHERS) else on).outcomes
    comparison = _of(outcomes.tested if on == UNTUNED else outcomes.comparisons, method)
    estimate = comparison.like if on == OTHERS else comparison.these
    if estimate is None:
        raise ValueError("expected several scenes")
    interval = estimate.interval(comparison.tests if corrected else 1)
    return Gain(estimate.mean, interval, corrected)


def loss(study: str, method: str, over: str = "", on: str = "", corrected: bool = True) -> Gain:
    """The same with the opposite sign."""
    return -gain(study, method, over, on, corrected)


def between(study: str, method: str) -> Gain:
    """The gain in PSNR over the other capacity of the same method."""
    for contest in _findings(study).contests:
        c = contest.comparison
        gain = Gain(c.difference, c.joint, corrected=True)
        if c.method.is_called(method):
            return gain
        if c.baseline.is_called(method):
            return -gain
    raise ValueError(f"expected a method with two capacities, got {method}")


def possible(study: str, method: str) -> str:
    """The largest effect that a stress study does not exclude at any strength, as `1.1 dB`."""
    limits = [limit for limit in _findings(study).limits if limit.method.is_called(method)]
    effect = largest_effect(interval for limit in limits for _, interval in limit.gains)
    return f"{format_significant(effect)} dB"


def sigma_ratio(study: str, method: str, over: str = "", on: str = "") -> str:
    """The ratio of the standard deviations over seeds, as `1.01 (0.77 to 1.31)`."""
    sigmas = _findings(study, over, on).outcomes.sigmas
    comparison = _of(sigmas, method)
    if comparison.ratio is None or comparison.interval is None:
        raise ValueError("expected different seeds to differ")
    low, high = comparison.interval.low, comparison.interval.high
    return f"{comparison.ratio:.2f} ({low:.2f} to {high:.2f})"


def mean(study: str, method: str, metric: str = "psnr", on: str = "") -> float:
    """A column of `means`, on one scene or over all."""
    return float(means(study, on).loc[method, metric])


def lpips(study: str, method: str, on: str = "") -> str:
    """Mean LPIPS on [0, 1] images, as `.148`."""
    return f"{mean(study, method, 'lpips_01', on):.3f}".removeprefix("0")


def acted(study: str, method: str, on: str = "") -> str:
    """The share of its opportunities in which a method acted that the report calls hardly tested,
    as `39 %`."""
    idle = _of({idle.method: idle for idle in _findings(study, on=on).idle}, method)
    return f"{100 * idle.share:.0f} %"


def _of(results: Mapping[Method, T], method: str) -> T:
    """The result of the method with this name."""
    for each, result in results.items():
        if each.is_called(method):
            return result
    raise ValueError(f"expected one of {', '.join(m.name for m in results)}; got {method}")


@functools.cache
def means(study: str, scene: str = "") -> pd.DataFrame:
    """Mean over seeds and then scenes; a row for each method.

    Args:
        scene: only this one, or those of a data set, as `llff`.
    """
    runs = _runs(study)
    if scene:
        names = runs["scene"]
        runs = runs[(names == scene) | names.str.startswith(f"{scene}_")]
    numbers = runs.groupby(["method", "scene"]).mean(numeric_only=True)
    return numbers.groupby("method").mean()


@functools.cache
def _runs(study: str) -> pd.DataFrame:
    return load_study(COMMITTED / study).runs


@functools.cache
def _findings(study: str, baseline: str = "", on: str = "") -> Findings:
    """What the runs of a study show, or those of one of its scenes."""
    every = collect(COMMITTED / study, rival=baseline)
    runs = tuple(run for run in every.runs if on in ("", run.scene))
    if not runs:
        raise ValueError(f"expected a scene of {study}, got {on}")
    return find(replace(every, runs=runs))


def with_values(text: str) -> str:
    """The page with the values that its marks give.

    Raises:
        ValueError: A mark has no value, or is where Markdown would not take it as part of a
            sentence.
    """
    for line in text.splitlines():
        if FIRST.match(line) or line.count("<!-- = ") != len(MARK.findall(line)):
            raise ValueError(
                "expected a mark with text before it in its line, without `|`, and `<!-- -->`"
                f" after its value, got {line!r}"
            )
    return MARK.sub(lambda match: f"<!-- = {match[1]} -->{value(match[1])}<!-- -->", text)


def value(expression: str) -> str:
    """What an expression gives: decimals with two places, whole numbers with commas."""
    try:
        result = LANGUAGE.compile_expression(expression, undefined_to_none=False)()
    except (LookupError, TypeError, ValueError, TemplateError, UserError) as error:
        raise ValueError(f"{expression}: {error}") from error
    if isinstance(result, float):
        return _decimals(result)
    return f"{result:,}" if isinstance(result, int) else str(result)


def _decimals(number: float) -> str:
    return f"{round(number, 2) + 0.0:.2f}"  # + 0.0: no "-0.00"


LANGUAGE = Environment(undefined=StrictUndefined, autoescape=False)
LANGUAGE.globals = {
    f.__name__: f for f in (gain, loss, between, possible, sigma_ratio, mean, lpips, acted, round)
}
