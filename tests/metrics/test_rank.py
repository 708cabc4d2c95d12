"""The effective rank of Gaussians is 1 for needles, 2 for discs, 3 for balls."""

from __future__ import annotations

import math

import numpy as np
import pytest

from framework.metrics.coadaptation import effective_rank, with_rank
from framework.metrics.evaluate import evaluate_view
from framework.metrics.values import Missing
from tests.record.fakes import make_view


@pytest.mark.parametrize(
    ("scales", "rank"),
    [((1e-9, 1e-9, 2.0), 1.0), ((3.0, 1e-9, 3.0), 2.0), ((0.1, 0.1, 0.1), 3.0)],
)
def test_of_needles_discs_and_balls(scales: tuple[float, ...], rank: float) -> None:
    assert effective_rank(np.log([scales])) == pytest.approx(rank, abs=1e-9)


def test_it_is_the_mean_of_the_exponential_of_the_entropy() -> None:
    shares = 4 / 5, 1 / 5  # of squares 4 and 1
    needle_like = math.exp(-sum(q * math.log(q) for q in shares))
    logs = np.log([[2.0, 1.0, 1e-200], [1.0, 1.0, 1.0]])
    assert effective_rank(logs) == pytest.approx((needle_like + 3) / 2)
    assert effective_rank(1.5 + logs) == pytest.approx((needle_like + 3) / 2), "in any unit"


def test_without_a_gaussian_there_is_none() -> None:
    assert math.isnan(effective_rank(np.zeros((0, 3))))
    (view,) = with_rank([evaluate_view(make_view(0), make_view(1).image, 0.01)], np.zeros((0, 3)))
    assert isinstance(view.value("effective_rank"), Missing)


def test_it_stands_beside_the_metrics_of_every_view() -> None:
    view = evaluate_view(make_view(0), make_view(1).image, 0.01)
    (ranked,) = with_rank([view], np.zeros((5, 3)))
    assert ranked.value("effective_rank") == pytest.approx(3) and ranked.psnr == view.psnr
