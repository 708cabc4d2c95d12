"""UAR: who is a candidate, how many are dropped, what the others get."""

import pytest
import torch

from framework.fisher.information import FisherInformation
from framework.plugin import StepContext
from plugins.regularize.uar import Ranking, Uar
from tests.plugins.fakes import context, known_information

N = 400
UNSEEN = slice(300, 400)


def information() -> torch.Tensor:
    """[N]: Gaussian i knows more the larger i is; the last hundred are seen by no view."""
    reference = 10.0 ** (1 + torch.arange(N) / 100.0)
    reference[UNSEEN] = 0
    return reference


def ctx(**changes: float) -> StepContext:
    return context(fisher=lambda *_, **__: known_information(information()), **changes)  # type: ignore[arg-type]


def factors(uar: Uar, context: StepContext, state: Ranking | None = None) -> torch.Tensor:
    result, _ = uar.opacity_factors(context, state)
    assert result is not None and result.shape == (N,) and result.dtype == torch.float32
    return result


def test_candidates_are_the_least_uncertain() -> None:
    result = factors(Uar(mode="hard", p=0.2, schedule="constant"), ctx())
    changed = torch.nonzero(result != 1).flatten()
    candidates = range(300 - 160, 300)  # C p N = 160, from the best known seen one downwards
    assert len(changed) > 0 and set(changed.tolist()) <= set(candidates)


@pytest.mark.parametrize(("mode", "factor"), [("hard", 2.0), ("soft", 2.0), ("soft", 3.5)])
@pytest.mark.parametrize("compensate", [False, True])
def test_expectation_of_every_candidate(mode: str, factor: float, compensate: bool) -> None:
    """Over many steps a candidate's mean factor is 1 - (1 - s) / C, with compensation 1; a Gaussian
    that is no candidate always has 1."""
    uar = Uar(
        mode=mode, p=0.15, schedule="constant", candidate_factor=factor, compensate=compensate
    )
    state, rows = None, []
    for draw in range(300):
        result, state = uar.opacity_factors(ctx(step=50, seed=draw), state)
        assert result is not None
        rows.append(result.double())
    assert state is not None
    mean = torch.stack(rows).mean(0)
    candidates = state.order[: round(factor * 0.15 * N)]
    others = torch.ones(N, dtype=torch.bool)
    others[candidates] = False
    assert bool((mean[others] == 1).all())
    s, kept = uar.dropped_factor, uar.kept_factor
    expected = 1.0 if compensate else 1 - (1 - s) / factor
    assert s / factor + kept * (1 - 1 / factor) == pytest.approx(expected)
    tested = uar.expected_factors(ctx(step=50), state)
    assert bool((tested[others] == 1).all())
    if not compensate:
        assert tested[candidates].tolist() == pytest.approx([expected] * len(candidates))
    sigma = (kept - s) * ((1 - 1 / factor) / factor / len(rows)) ** 0.5
    assert float((mean[candidates] - expected).abs().max()) < 5 * sigma
    assert abs(float(mean[candidates].mean()) - expected) < 4 * sigma / len(candidates) ** 0.5


def test_the_diagonal_form_ignores_what_parameters_tell_together() -> None:
    """Equal diagonals, one Gaussian with strong correlations: the block form finds it less certain,
    the diagonal form cannot distinguish it."""
    block = torch.eye(6).repeat(N, 1, 1)
    block[7, 0, 1] = block[7, 1, 0] = 0.9
    seen = torch.ones(N, dtype=torch.bool)
    correlated = FisherInformation(block, torch.ones(N, 14), seen)
    now = context(fisher=lambda *_, **__: correlated)
    _, by_block = Uar().opacity_factors(now, None)
    _, by_diagonal = Uar(form="diagonal").opacity_factors(now, None)
    assert int(by_block.order[-1]) == 7
    assert by_diagonal.order.tolist() == list(range(N))
