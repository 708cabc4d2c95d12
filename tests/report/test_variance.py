"""Deviations compared, break-down points, failure rates: known inputs, known answers."""

import math
from collections.abc import Sequence
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from framework.compute.rng import stream
from framework.report.render import say
from framework.report.statistics.breakdown import break_down
from framework.report.statistics.estimates import estimate
from framework.report.statistics.robustness import wilson
from framework.report.statistics.variance import compare_sigmas, detectable
from framework.report.study.methods import Method


def by_seed(values: Sequence[float], first: int = 0) -> dict[int, float]:
    return dict(enumerate(values, first))


def test_without_common_seeds_it_is_scipys_levene_about_the_median() -> None:
    draw = stream(0, "levene")
    a, b = 0.3 * draw.standard_normal(8), 0.1 * draw.standard_normal(8)
    actual = compare_sigmas("a", by_seed(a), "b", by_seed(b, 100))
    assert actual is not None and actual.ratio is not None and actual.interval is not None
    assert actual.rho is None
    assert actual.p == pytest.approx(stats.levene(a, b, center="median").pvalue)
    assert actual.ratio == pytest.approx(a.std(ddof=1) / b.std(ddof=1))
    assert actual.interval.low < actual.ratio < actual.interval.high


def test_common_seeds_are_pairs() -> None:
    """p is that of the correlation of differences and sums, of values or of ranks; the interval
    ends where that of values refutes."""
    shared, own_a, own_b = stream(0, "pairs").standard_normal((3, 9))
    a, b = 0.5 * (shared + 0.3 * own_a), shared + 0.3 * own_b
    actual = compare_sigmas("a", by_seed(a), "b", by_seed(b))
    assert actual is not None and actual.ratio is not None and actual.interval is not None
    message = [test(a - b, a + b).pvalue for test in (stats.pearsonr, stats.spearmanr)]
    assert actual.p == pytest.approx(max(message))
    assert actual.rho == pytest.approx(np.corrcoef(a, b)[0, 1])
    for end in (actual.interval.low, actual.interval.high):
        assert stats.pearsonr(a - end * b, a + end * b).pvalue == pytest.approx(0.05, abs=1e-9)
    more = compare_sigmas("a", by_seed([*a, 7.0]), "b", by_seed(b))
    assert more is not None and (more.n, more.other_n, more.p) == (9, 9, actual.p)


def test_of_seeds_that_move_as_one_the_ratio_is_nearly_known() -> None:
    """A correlation of exactly 1 leaves no noise; its replacement must not be noise either."""
    actual = compare_sigmas("a", by_seed([1.0, 2.0, 4.0, 7.0]), "b", by_seed([2.0, 4.0, 8.0, 14.0]))
    assert actual is not None and actual.interval is not None and actual.rho is not None
    assert actual.ratio == pytest.approx(0.5) and 1 - 1e-8 < actual.rho < 1
    assert 0.499 < actual.interval.low < 0.5 < actual.interval.high < 0.501


@pytest.mark.parametrize(("n", "least"), [(3, 2 / 6), (4, 2 / 24), (5, 2 / 120)])
def test_few_ranks_are_tested_over_all_permutations(n: int, least: float) -> None:
    a = 0.001 * stream(0, "few").standard_normal(n)
    actual = compare_sigmas("a", by_seed(a), "b", by_seed(range(n)))
    assert actual is not None and actual.p == pytest.approx(least)


@pytest.mark.parametrize("paired", [True, False])
@pytest.mark.parametrize("n", [3, 10])
def test_the_detectable_ratio_is_found_in_four_of_five_studies(n: int, paired: bool) -> None:
    """The tests themselves find it, on other draws than those of the simulation."""
    rho = 0.6 if paired else None
    lowest = detectable(n, n, 1, rho)
    if n == 3:
        assert lowest is None
        return
    assert lowest is not None
    a, b = stream(0, f"test/power/{n}").standard_normal((2, 1500, n))
    if rho is not None:
        b = rho * a + math.sqrt(1 - rho**2) * b
    first = Method("safi"), Method()
    found = 0
    for x, y in zip(lowest * a, b, strict=True):
        other = range(n) if paired else range(100, 100 + n)
        one = compare_sigmas(
            first[0], dict(enumerate(x)), first[1], dict(zip(other, y, strict=True))
        )
        found += one is not None and one.significant
    assert found / len(a) == pytest.approx(0.8, abs=0.04)


def test_degenerate_deviations() -> None:
    assert compare_sigmas("a", by_seed([1.0, 2.0]), "b", by_seed([1.0, 2.0, 3.0])) is None
    values = 1.0, 2.0, 4.0, 7.0, 9.0
    alike = compare_sigmas("a", by_seed(values), "b", by_seed([2 * v for v in values]))
    assert alike is not None and alike.p < 0.05 and alike.ratio == pytest.approx(0.5)


def test_a_break_down_between_two_strengths() -> None:
    noise = 0.01 * stream(0, "noise").standard_normal((3, 5))
    actual = break_down(np.array([0.0, 1.0, 2.0]), np.array([[1.0], [0.5], [-0.5]]) + noise)
    assert actual.helps and actual.starts is None and actual.significant
    assert actual.stops == pytest.approx(1.5, abs=0.02)
    assert actual.interval is not None and actual.interval.low < 1.5 < actual.interval.high
    assert actual.interval.high - actual.interval.low < 0.1


def test_fewer_views_are_the_harder_end() -> None:
    gains = np.array([[0.4, 0.4], [0.2, 0.2], [-0.2, -0.2]])
    actual = break_down(np.array([9.0, 5.0, 3.0]), gains)
    assert actual.stops == pytest.approx(4.0)
    assert actual.interval is not None and actual.interval.low == pytest.approx(4.0)


@pytest.mark.parametrize(
    ("means", "helps", "starts", "stops"),
    [
        ([1, 1, 1], True, None, None),
        ([-1, -1, 0], False, None, None),
        ([-1, 1, 1], True, 0.5, None),
        ([-1, 1, -1], True, 0.5, 1.5),
        ([1, -1, 1], True, None, 0.5),
    ],
)
def test_all_courses(
    means: list[float], helps: bool, starts: float | None, stops: float | None
) -> None:
    actual = break_down(np.arange(3.0), np.array(means, dtype=float)[:, None])
    assert (actual.helps, actual.starts, actual.stops) == (helps, starts, stops)
    assert actual.n == 1 and actual.interval is None and not actual.significant


def test_wilson_of_a_textbook() -> None:
    actual = wilson(1, 10)
    assert (actual.low, actual.high) == pytest.approx((0.0179, 0.4042), abs=1e-4)
    assert wilson(0, 10).low == 0 and wilson(10, 10).high == 1


def test_a_method_that_seeds_do_not_move() -> None:
    """The mean of equal numbers is rounded, which made a tiny spread and an absurd ratio of two."""
    still = dict.fromkeys(range(6), 20.1)
    moving = {seed: value for seed, value in enumerate((20.0, 21.0, 20.1, 21.1, 20.0, 21.05))}
    assert np.std([20.1] * 6, ddof=1) > 0 and estimate([20.1] * 6).sd == 0.0
    both = compare_sigmas("a", still, "b", {seed: value + 0.6 for seed, value in still.items()})
    assert both is not None and both.ratio is None and both.p == 1.0 and not both.significant
    a, b = Method("a"), Method("b")
    steadier = compare_sigmas(a, still, b, moving)
    looser = compare_sigmas(b, moving, a, still)
    assert steadier is not None and looser is not None and steadier.p == looser.p < 0.05
    texts = [say("spread", findings=SimpleNamespace(steadiness=[c])) for c in (steadier, looser)]
    assert "a does not vary and b does (p " in texts[0]
    assert "b varies and a does not (p " in texts[1]
