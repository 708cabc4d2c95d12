"""Every interval of a report covers the truth about as often as it says: simulated, within two
points of 95 %. Seeds are fixed, so the shares are the same on every machine."""

from typing import Any

import numpy as np
import pytest

from framework.compute.rng import stream
from framework.report.statistics.breakdown import break_down
from framework.report.statistics.compare import Pairs, compare
from framework.report.statistics.estimates import estimate
from framework.report.statistics.robustness import wilson
from framework.report.statistics.variance import brown_forsythe, compare_sigmas

TOLERANCE = 0.02
DRAWS = 1500


def covered(actual: list[object], truth: float) -> float:
    return float(np.mean([i is not None and i.low <= truth <= i.high for i in actual]))  # type: ignore[attr-defined]


def on_one(values: np.ndarray) -> Pairs:
    return {("scene", seed): float(value) for seed, value in enumerate(values)}


@pytest.mark.parametrize("n", [3, 10])
def test_mean_and_deviation(n: int) -> None:
    draws = 25 + 0.1 * stream(n, "spread").standard_normal((DRAWS, n))
    actual = [estimate(list(row)) for row in draws]
    assert covered([f.interval() for f in actual], 25.0) == pytest.approx(0.95, abs=TOLERANCE)
    assert covered([f.sd_interval for f in actual], 0.1) == pytest.approx(0.95, abs=TOLERANCE)


@pytest.mark.parametrize("n", [3, 10])
def test_paired_difference(n: int) -> None:
    """Runs of one seed share much; the interval is of what they do not share."""
    draw = stream(n, "pairs")
    actual = []
    for _ in range(DRAWS):
        shared = draw.standard_normal(n)
        a, b = (shared + 0.3 * draw.standard_normal(n) for _ in range(2))
        comparison = compare("a", on_one(a + 0.2), "b", on_one(b))
        actual.append(comparison.interval if comparison else None)
    assert covered(actual, 0.2) == pytest.approx(0.95, abs=TOLERANCE)


def test_ratio_of_deviations() -> None:
    draw = stream(0, "ratio")
    pairs = [(0.3 * draw.standard_normal(6), 0.1 * draw.standard_normal(9)) for _ in range(DRAWS)]
    actual = [
        compare_sigmas("a", dict(enumerate(a)), "b", dict(enumerate(b, 100))) for a, b in pairs
    ]
    assert covered([f.interval if f else None for f in actual], 3.0) == pytest.approx(
        0.95, abs=TOLERANCE
    )


@pytest.mark.parametrize("n", [10, 40])
def test_share_of_failures(n: int) -> None:
    """A share's coverage jumps with the truth, so it is the mean over all truths that counts."""
    draw = stream(n, "share")
    truths = draw.random(DRAWS)
    actual = [wilson(int(draw.binomial(n, p)), n) for p in truths]
    inside = [i.low <= p <= i.high for i, p in zip(actual, truths, strict=True)]
    assert np.mean(inside) == pytest.approx(0.95, abs=TOLERANCE)


@pytest.mark.parametrize(("n", "strengths"), [(3, [0, 1, 2, 3, 4]), (10, [9, 7, 5, 3, 2])])
def test_break_down_point(n: int, strengths: list[float]) -> None:
    """The truth falls in a straight line through zero between two tested strengths."""
    draw, x = stream(n, "breakdown"), np.array(strengths, dtype=float)
    zero = x[2] + 0.3 * (x[3] - x[2])
    truth = 0.4 * (zero - x) * np.sign(x[1] - x[0])
    actual = []
    for _ in range(DRAWS):
        noise = 0.1 * draw.standard_normal((len(x), n)) + 0.1 * draw.standard_normal(n)
        actual.append(break_down(x, truth[:, None] + noise).interval)
    assert covered(actual, zero) == pytest.approx(0.95, abs=TOLERANCE)


def test_brown_forsythe_keeps_its_level() -> None:
    """Equal deviations are called different about as often as 5 %, not more."""
    draw = stream(0, "levels")
    pairs = draw.standard_normal((DRAWS, 2, 10))
    share = np.mean([brown_forsythe(a, b) < 0.05 for a, b in pairs])
    assert share == pytest.approx(0.05, abs=TOLERANCE)


@pytest.mark.parametrize("shared", [0.0, 0.2])
def test_these_scenes_and_scenes_like_these(shared: float) -> None:
    """Effects differ between scenes, and a seed may move all scenes alike: each interval covers
    what it is about, and pairs taken for independent would cover neither."""
    draw, scenes, seeds = stream(1, "scenes and seeds"), 5, 4
    these, like, pooled = [], [], []
    for _ in range(DRAWS):
        effects = 0.3 * draw.standard_normal(scenes)
        noise = 0.1 * draw.standard_normal((scenes, seeds)) + shared * draw.standard_normal(seeds)
        d = effects[:, None] + noise
        values = {(f"{s}", k): float(d[s, k]) for s in range(scenes) for k in range(seeds)}
        actual = compare("a", values, "b", dict.fromkeys(values, 0.0))
        assert actual is not None
        these.append((actual.interval, effects.mean()))
        like.append((actual.like_joint, 0.0))
        pooled.append((estimate(list(values.values())).interval(), 0.0))

    def share(pairs: list[tuple[Any, float]]) -> float:
        return float(np.mean([i.low <= truth <= i.high for i, truth in pairs]))

    assert share(these) == pytest.approx(0.95, abs=TOLERANCE)
    if not shared:  # what all scenes share of a seed is no part of what differs between scenes
        assert share(like) == pytest.approx(0.95, abs=TOLERANCE)
    assert share(pooled) < 0.75
