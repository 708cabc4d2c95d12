"""The statistics against scipy, textbook values and simulation."""

import pytest
from scipy import stats

from framework.compute.rng import stream
from framework.report.statistics.compare import compare, corrected
from framework.report.statistics.estimates import Interval, estimate
from framework.report.statistics.numbers import format_interval, format_span


def test_spread_of_known_values() -> None:
    actual = estimate([1.0, 2.0, 3.0])
    assert (actual.n, actual.mean, actual.sd) == (3, 2.0, 1.0)
    assert actual.interval() is not None and actual.sd_interval is not None
    # t(.975, 2) = 4.3027; chi2(2) quantiles 7.3778 and 0.0506
    assert actual.interval().high == pytest.approx(2 + 4.3027 / 3**0.5, abs=1e-4)
    assert actual.sd_interval.low == pytest.approx((2 / 7.3778) ** 0.5, abs=1e-4)
    assert actual.sd_interval.high == pytest.approx((2 / 0.0506356) ** 0.5, abs=1e-3)


def test_one_value_says_nothing_about_spread() -> None:
    actual = estimate([5.0])
    assert actual.mean == 5.0
    assert actual.sd is None and actual.sd_interval is None and actual.interval() is None


def test_comparison_pairs_by_key_and_equals_scipy() -> None:
    draw = stream(0, "pairs")
    values = {("s", seed): 20 + float(draw.standard_normal()) for seed in range(6)}
    others = {key: value - 0.3 + 0.1 * float(draw.random()) for key, value in values.items()}
    others["s", 99] = 500.0
    actual = compare("a", values, "b", others)
    keys = sorted(values)
    expected = stats.ttest_rel([values[k] for k in keys], [others[k] for k in keys])
    interval = expected.confidence_interval()
    assert actual is not None and actual.interval is not None and actual.n == 6
    assert actual.p == pytest.approx(expected.pvalue, rel=1e-9)
    assert (actual.interval.low, actual.interval.high) == pytest.approx(tuple(interval), rel=1e-9)


def test_comparison_of_few_or_equal_pairs() -> None:
    assert compare("a", {("s", 1): 2.0}, "b", {("s", 2): 2.0}) is None
    single = compare("a", {("s", 1): 2.0}, "b", {("s", 1): 1.5})
    assert single is not None and single.difference == 0.5
    assert single.interval is None and single.p is None and not single.significant
    twice = {("s", 1): 2.0, ("s", 2): 3.0}
    equal = compare("a", twice, "b", twice)
    assert equal is not None and equal.p == 1.0 and equal.difference == 0.0
    assert not equal.significant
    shifted = compare("a", {key: value + 1 for key, value in twice.items()}, "b", twice)
    assert shifted is not None and shifted.p == 0.0 and shifted.significant


def test_seeds_and_scenes_are_averaged_over_the_other_first() -> None:
    values = {("x", 0): 1.0, ("x", 1): 2.0, ("y", 0): 3.0, ("y", 1): 6.0, ("y", 2): 99.0}
    actual = compare("a", values, "b", dict.fromkeys(values, 0.0))
    assert actual is not None and actual.like is not None
    assert actual.scenes == ("x", "y")
    assert (actual.n, actual.difference) == (
        2,
        3.0,
    )  # of (1 + 3) / 2 and (2 + 6) / 2; seed 2 lacks x
    assert actual.like.n == 2 and actual.like.mean == pytest.approx((1.5 + 36) / 2)


def test_conditions_of_one_scene_count_as_one_scene() -> None:
    values = {("x (1)", 0): 1.0, ("x (2)", 0): 3.0, ("y", 0): 8.0, ("z", 0): 5.0}
    names = {"x (1)": "x", "x (2)": "x"}
    actual = compare("a", values, "b", dict.fromkeys(values, 0.0), names)
    assert actual is not None and actual.like is not None
    assert (actual.like.n, actual.like.mean) == (3, 5.0)  # of 2, 8 and 5
    expected = stats.ttest_1samp([2.0, 8.0, 5.0], 0).confidence_interval()
    interval = actual.like.interval()
    assert interval is not None
    assert (interval.low, interval.high) == pytest.approx(tuple(expected), rel=1e-9)
    assert actual.difference == 4.25  # these scenes: each condition as it is
    alone = {key: value for key, value in values.items() if key[0].startswith("x")}
    of_one = compare("a", alone, "b", dict.fromkeys(alone, 0.0), names)
    assert of_one is not None and of_one.like is None, "one scene gives no evidence on others"


def test_no_seed_on_all_scenes_is_no_test() -> None:
    values = {("x", 0): 1.0, ("y", 1): 3.0}
    actual = compare("a", values, "b", dict.fromkeys(values, 0.0))
    assert actual is not None and actual.n == 0 and actual.difference == 2.0
    assert actual.interval is None and actual.joint is None and not actual.significant


def test_correction_is_for_what_can_be_tested() -> None:
    one = compare("a", {("s", 1): 2.0}, "b", {("s", 1): 1.5})
    two = compare("c", {("s", 1): 2.0, ("s", 2): 2.5}, "b", {("s", 1): 1.5, ("s", 2): 1.9})
    assert one is not None and two is not None and two.p is not None
    message = corrected({"a": one, "c": two, "d": two})
    assert message["c"].tests == 2 and message["c"].p_joint == pytest.approx(2 * two.p)
    assert message["c"].joint is not None and two.interval is not None
    assert message["c"].joint.low < two.interval.low


def test_an_end_beside_zero_is_not_rounded_to_it() -> None:
    assert format_interval(Interval(-0.21, -0.0041)) == "-0.21 to -0.004"
    assert format_interval(Interval(-0.21, 0.0041)) == "-0.21 to 0.004"
    assert format_interval(Interval(0.0, 0.0)) == "0.00 to 0.00"
    assert format_span(Interval(0.084, 1.0)) == "0.084 to 1.0"
    assert format_span(Interval(0.011, 4.5e36)) == "0.011 or more"
    assert format_interval(Interval(-1e-16, 2e-16)) == "0.00 to 0.00"
    assert format_interval(Interval(-0.0, 0.5)) == "0.00 to 0.50"
    assert format_interval(Interval(0.12, 0.48)) == "0.12 to 0.48"
