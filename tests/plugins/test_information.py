"""Information gain and uncertainty: definitions, bounds and invariances."""

import math

import numpy as np
import pytest
import torch

from framework.compute.rng import stream
from framework.fisher.scores import NOISE, block_prior, information_gains, shared_prior, uncertainty


def information_gain(
    candidate: torch.Tensor, reference: torch.Tensor, regulariser: float, form: str = "trace"
) -> float:
    """Gain of one view over another, under the prior of the candidate alone."""
    prior = shared_prior([candidate], regulariser)
    return information_gains(candidate, [reference], prior, form)[0]


def diagonals(seed: int, n: int = 200, p: int = 14) -> torch.Tensor:
    return torch.from_numpy(stream(seed, "diagonal").lognormal(0, 3, (n, p)))


def blocks(seed: int, n: int = 100, rank: int = 6) -> torch.Tensor:
    """[n, 6, 6] random positive semi-definite of the given rank."""
    factor = torch.from_numpy(stream(seed, "block").standard_normal((n, 6, rank)))
    return factor @ factor.transpose(1, 2)


def test_gain_by_hand() -> None:
    candidate = torch.tensor([[4.0], [8.0], [6.0]])
    reference = torch.tensor([[1.0], [0.0], [5.4]])
    ratios = [4 / 1.6, 8 / 0.6, 6 / 6.0]  # the median of the candidate is 6, lambda 0.6
    assert information_gain(candidate, reference, 0.1) == pytest.approx(0.5 * sum(ratios))
    entropy = 0.5 * sum(math.log(1 + r) for r in ratios)
    assert information_gain(candidate, reference, 0.1, "log") == pytest.approx(entropy)


@pytest.mark.parametrize("form", ["trace", "log"])
def test_gain_is_free_of_units(form: str) -> None:
    """Rescaling a parameter multiplies its information in both views."""
    candidate, reference = diagonals(0), diagonals(1)
    unit = 10.0 ** torch.linspace(-2, 2, 14)
    plain = information_gain(candidate, reference, 0.1, form)
    assert information_gain(candidate * unit, reference * unit, 0.1, form) == pytest.approx(plain)


def test_uncertainty_is_minus_the_log_determinant() -> None:
    f, seen = blocks(0), torch.ones(100, dtype=torch.bool)
    s = torch.diag(torch.tensor([2.0, 2, 2, 1, 1, 1]).double())
    normalised = s @ f @ s
    diagonal = normalised.diagonal(dim1=1, dim2=2).numpy()
    prior = [1e-3 * float(np.median(diagonal[:, g])) for g in (slice(0, 3), slice(3, 6))]
    total = normalised + torch.diag(torch.tensor(prior).double().repeat_interleave(3))
    total += NOISE * torch.diag_embed(normalised.diagonal(dim1=1, dim2=2))
    expected = -torch.linalg.slogdet(total).logabsdet
    torch.testing.assert_close(uncertainty(f, seen, 2.0, 1e-3), expected, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("regulariser", [1.0, 1e-3, 1e-6])
def test_block_gains_are_those_of_the_docstring_s_equation(regulariser: float) -> None:
    """With NOISE's share of the floor, which decides where a singular block has no other."""
    ours, reference = blocks(0, rank=5), blocks(1, rank=5)
    prior = block_prior([ours, reference], regulariser)

    def gains(noise: float) -> tuple[float, float]:
        floor = torch.diag_embed(prior + noise * (reference + ours).diagonal(dim1=1, dim2=2))
        ratio = torch.linalg.solve(reference + floor, ours)
        logs = [
            torch.linalg.slogdet(of).logabsdet.sum()
            for of in (reference + ours + floor, reference + floor)
        ]
        return 0.5 * float(ratio.diagonal(dim1=1, dim2=2).sum()), 0.5 * float(logs[0] - logs[1])

    actual = [information_gains(ours, [reference], prior, form)[0] for form in ("trace", "log")]
    assert actual == pytest.approx(gains(NOISE), rel=1e-6)
    if regulariser == 1e-6:
        assert gains(0.0)[0] > 2 * actual[0]


def test_unseen_is_infinite_and_rank_deficient_is_finite_but_worse() -> None:
    full, flat = blocks(0), blocks(0, rank=5)
    seen = torch.ones(200, dtype=torch.bool)
    seen[:10] = False
    scores = uncertainty(torch.cat([full, flat]), seen, 1.0, 1e-6)
    assert bool((scores[:10] == math.inf).all()) and bool(torch.isfinite(scores[10:]).all())
    assert scores[100:].median() > scores[10:100].median()


def test_uncertainty_is_free_of_units_and_of_rigid_motion() -> None:
    f, seen = blocks(0), torch.ones(100, dtype=torch.bool)
    base = uncertainty(f, seen, 2.0, 1e-3)
    unit = torch.tensor([1e-3] * 3 + [1.0] * 3).double()
    torch.testing.assert_close(uncertainty(f * unit[:, None] * unit, seen, 2000.0, 1e-3), base)
    q, _ = torch.linalg.qr(torch.from_numpy(stream(4, "turn").standard_normal((3, 3))))
    turn = torch.block_diag(q, torch.eye(3).double())
    turned = uncertainty(turn @ f @ turn.T, seen, 2.0, 1e-3)
    # The median of the rotated diagonals moves a little; the order must not.
    assert torch.corrcoef(torch.stack([base, turned]))[0, 1] > 0.9999
