"""Uniform dropout: how many, who, and what the others get."""

import pytest
import torch

from plugins.regularize.uniform import Uniform
from tests.plugins.fakes import context, wall_of_gaussians

N = 400


def factors(uniform: Uniform, step: int = 50, seed: int = 0) -> torch.Tensor:
    result, state = uniform.opacity_factors(context(step=step, seed=seed), None)
    assert state is None
    assert result is not None and result.shape == (N,) and result.dtype == torch.float32
    return result


@pytest.mark.parametrize("count", ["bernoulli", "exact"])
def test_the_expected_share_is_dropped(count: str) -> None:
    uniform = Uniform(p=0.15, schedule="constant", count=count)
    counts = torch.tensor([int((factors(uniform, step) == 0).sum()) for step in range(100)])
    sigma = (0.15 * 0.85 * N / 100) ** 0.5
    assert abs(float(counts.double().mean()) - 0.15 * N) < 4 * sigma
    assert (int(counts.min()) == int(counts.max())) == (count == "exact")
    if count == "exact":
        assert int(counts[0]) == 60


@pytest.mark.parametrize("count", ["bernoulli", "exact"])
def test_compensation_keeps_the_expected_opacity(count: str) -> None:
    uniform = Uniform(p=0.3, schedule="constant", count=count, compensate=True)
    values = torch.stack([factors(uniform, step) for step in range(100)]).double()
    assert values.unique().tolist() == pytest.approx([0.0, 1 / 0.7], rel=1e-6)
    sigma = (0.3 / 0.7 / values.numel()) ** 0.5
    assert abs(float(values.mean()) - 1) < 4 * sigma
    if count == "exact":  # then not only in expectation
        assert values.mean(1).tolist() == pytest.approx([1.0] * 100, rel=1e-6)


def test_an_exact_count_is_compensated_by_what_is_really_dropped() -> None:
    """7 Gaussians and p = 0.2: one is dropped, a seventh and not a fifth."""
    now = context(gaussians=wall_of_gaussians(7))
    uniform = Uniform(p=0.2, schedule="constant", count="exact", compensate=True)
    result, _ = uniform.opacity_factors(now, None)
    assert result is not None and int((result == 0).sum()) == 1
    assert float(result.sum()) == pytest.approx(7)


def test_the_schedule_is_that_of_dropgaussian() -> None:
    """p(t) = p t / T: at half the training half of p."""
    uniform = Uniform(p=0.2)
    assert uniform.opacity_factors(context(step=0), None)[0] is None
    assert uniform.drop_rate(0.5) == pytest.approx(0.1)
    assert int((factors(Uniform(p=0.2, count="exact")) == 0).sum()) == 40
    assert Uniform(p=0.2, schedule="constant").drop_rate(0.01) == 0.2
