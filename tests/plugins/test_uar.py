"""UAR: who is a candidate, how many are dropped, what the others get."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from framework import registry
from framework.errors import UserError
from framework.fisher.information import FisherInformation
from framework.plugin import StepContext
from framework.types import Camera
from plugins.regularize.uar import Ranking, Uar
from tests.plugins.fakes import context, known_information, wall_of_gaussians

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


def test_unseen_gaussians_are_never_dropped() -> None:
    uar = Uar(mode="hard", p=0.6, schedule="constant", candidate_factor=1.6)
    for step in range(50):
        assert bool((factors(uar, ctx(step=step))[UNSEEN] == 1).all())


@pytest.mark.parametrize("factor", [1.5, 2.0, 4.0])
def test_expected_share_dropped_is_p(factor: float) -> None:
    uar = Uar(mode="hard", p=0.15, schedule="constant", candidate_factor=factor)
    counts = [int((factors(uar, ctx(step=step)) == 0).sum()) for step in range(300)]
    candidates = round(factor * 0.15 * N)
    sigma = (candidates / factor * (1 - 1 / factor) / len(counts)) ** 0.5
    assert abs(sum(counts) / len(counts) - 0.15 * N) < 4 * sigma
    assert max(counts) <= candidates


def test_linear_schedule_grows_with_progress() -> None:
    uar = Uar(p=0.2)
    assert uar.drop_rate(0.0) == 0 and uar.drop_rate(0.5) == pytest.approx(0.1)
    assert Uar(p=0.2, schedule="constant").drop_rate(0.1) == 0.2
    result, ranking = uar.opacity_factors(ctx(step=0), None)
    assert result is None and len(ranking.order) == 300


@pytest.mark.parametrize(("mode", "dropped"), [("hard", 0.0), ("soft", 0.2)])
def test_values_by_mode(mode: str, dropped: float) -> None:
    result = factors(Uar(mode=mode, schedule="constant"), ctx())
    assert result.unique().tolist() == pytest.approx([dropped, 1.0])


@pytest.mark.parametrize("mode", ["hard", "soft"])
def test_compensation_keeps_the_expected_opacity_of_candidates_only(mode: str) -> None:
    uar = Uar(mode=mode, schedule="constant", candidate_factor=3.0, compensate=True)
    c, kept = uar.candidate_factor, uar.kept_factor
    assert uar.dropped_factor / c + kept * (1 - 1 / c) == pytest.approx(1.0)
    values = factors(uar, ctx()).unique().tolist()
    assert values == pytest.approx(sorted([uar.dropped_factor, 1.0, kept]))


def test_ranking_is_refreshed_by_age_and_by_version_only() -> None:
    passes: list[Camera] = []

    def counted(camera: Camera, **_: object):  # type: ignore[no-untyped-def]
        passes.append(camera)
        return known_information(information())

    uar, state = Uar(refresh=10), None
    expected = {5: 3, 14: 3, 15: 6, 16: 6, 17: 9}
    for step, total in expected.items():
        now = context(fisher=counted, step=step, version=int(step >= 17))
        _, state = uar.opacity_factors(now, state)
        assert len(passes) == total


def test_a_photo_tells_of_what_its_mask_leaves_alone() -> None:
    mask, asked = torch.zeros(48, 64), []
    plain = ctx()
    views = tuple(replace(view, mask=mask) for view in plain.views)

    def noted(_: Camera, mask: object):  # type: ignore[no-untyped-def]
        asked.append(mask)
        return known_information(information())

    Uar().opacity_factors(replace(plain, views=views, fisher=noted), None)
    assert len(asked) == len(views) and all(one is mask for one in asked)


def test_views_add_up_and_a_gaussian_any_view_sees_is_ranked() -> None:
    """Each view sees another third; together they see all but the unseen."""
    turns = iter(range(3))

    def partly(_: Camera, **__: object):  # type: ignore[no-untyped-def]
        keep = torch.arange(N) % 3 == next(turns)
        return known_information(torch.where(keep, information(), 0.0))

    _, ranking = Uar().opacity_factors(context(fisher=partly), None)
    assert ranking.order.tolist() == list(range(299, -1, -1))


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


def test_what_is_evaluated_can_be_as_dim_as_in_training() -> None:
    """A ranking of another set of Gaussians is of no use; the others keep their bits."""
    uar = Uar(p=0.15, schedule="constant", scale_tested=True)
    now = ctx(step=50)
    bright = wall_of_gaussians(N).replace(opacity_logits=torch.linspace(-90, 90, N))
    _, state = uar.opacity_factors(now, None)
    dim = uar.evaluated(now, bright, state).opacity_logits
    stale = Ranking(torch.arange(5), state.step, state.version + 1)
    assert torch.equal(dim, uar.evaluated(now, bright, stale).opacity_logits)
    changed = dim != bright.opacity_logits
    assert changed.nonzero().flatten().tolist() == state.order[:120].sort().values.tolist()
    expected = bright.opacities.double() * (1 - 0.8 / 2)
    assert torch.allclose(torch.sigmoid(dim.double())[changed], expected[changed], rtol=1e-5)
    assert Uar().evaluated(now, bright, state) is bright


def test_to_compensate_twice_is_refused() -> None:
    with pytest.raises(UserError, match=r"scale_tested: expected false beside compensate=true"):
        Uar(compensate=True, scale_tested=True)


def test_what_would_scale_nothing_is_refused() -> None:
    chosen = {"name": "uar", "scale_tested": True}
    with pytest.raises(
        UserError, match=r"^reg\.scale_tested: expected false, or reg\.stop=1: .*True"
    ):
        registry.build("reg", chosen)
    assert registry.build("reg", chosen | {"stop": 1.0}).plugin.scale_tested
