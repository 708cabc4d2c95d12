"""The effective rank of Gaussians is 1 for needles, 2 for discs, 3 for balls."""

import math

import numpy as np
import pytest

from framework.metrics.coadaptation import effective_rank, with_rank
from framework.metrics.values import Missing
from tests.record.fakes import make_view, measured


@pytest.mark.parametrize(
    ("scales", "rank"), [((1e-9, 1e-9, 2.0), 1.0), ((3.0, 1e-9, 3.0), 2.0), ((0.1, 0.1, 0.1), 3.0)]
)
def test_of_needles_discs_and_balls(scales: tuple[float, ...], rank: float) -> None:
    assert effective_rank(np.log([scales])) == pytest.approx(rank, abs=1e-9)


def test_without_a_gaussian_there_is_none() -> None:
    assert math.isnan(effective_rank(np.zeros((0, 3))))
    (view,) = with_rank([measured(make_view(0), make_view(1).image)], np.zeros((0, 3)))
    assert isinstance(view.value("effective_rank"), Missing)
