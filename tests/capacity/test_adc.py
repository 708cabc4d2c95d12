"""Adaptive density control on hand-made Gaussians whose fate is known."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest
import torch

from framework.compute.rng import stream
from framework.errors import UserError
from framework.plugin import Edits, StepContext, StepStats
from framework.registry import build
from framework.types import Gaussians, concatenate
from plugins.capacity.adc import AdaptiveDensityControl, Pull

EXTENT = 10.0  # "small" is up to 0.1 with percent_dense = 0.01
WIDTH, HEIGHT = 200, 100
SMALL, LARGE, OPAQUE, CLEAR = 0.05, 0.5, 0.5, 0.004


def gaussians(*rows: tuple[float, float]) -> Gaussians:
    """One Gaussian per (largest scale, opacity); the other attributes distinguish them."""
    n = len(rows)
    scales, opacities = torch.tensor(rows).unbind(1)
    index = torch.arange(n, dtype=torch.float32)
    return Gaussians(
        means=index[:, None].repeat(1, 3),
        quats=torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(n, 1),
        log_scales=(scales[:, None] * torch.tensor([1.0, 0.5, 0.1])).log(),
        opacity_logits=torch.logit(opacities),
        sh0=index[:, None, None].repeat(1, 1, 3),
        shN=torch.zeros(n, 3, 3),
    )


def context(
    subject: Gaussians, finished: int, seed: int = 0, log: dict[str, float] | None = None
) -> StepContext:
    def unreachable(*_: Any) -> Any:
        raise AssertionError("density control renders nothing")

    return StepContext(
        step=finished - 1,
        n_steps=10_000,
        epoch=0,
        views=(),
        depth=(),
        gaussians=subject,
        version=0,
        sh_degree=1,
        background=torch.zeros(3),
        extent=EXTENT,
        spacing=EXTENT,
        near=1.0,
        far=20.0,
        supports=unreachable,
        render=unreachable,
        fisher=unreachable,
        rng=lambda purpose: stream(seed, f"capacity/adc/{purpose}", finished),
        log=(lambda name, value: None) if log is None else log.__setitem__,
    )


def stats(pulls: list[float], radii: list[float] | None = None) -> StepStats:
    """Gradients in x alone with these norms in NDC."""
    gradient = torch.zeros(len(pulls), 2)
    gradient[:, 0] = torch.tensor(pulls) / (WIDTH / 2)
    return StepStats(gradient, torch.tensor(radii or [3.0] * len(pulls)), WIDTH, HEIGHT)


def densify(
    subject: Gaussians, pulls: list[float], seed: int = 0, **options: Any
) -> tuple[Edits, Pull]:
    """The edits after 600 steps with one measurement, and the state after them."""
    adc = AdaptiveDensityControl(**options)
    ctx = context(subject, 600, seed)
    edits, state = adc.update(ctx, adc.init_state(ctx), stats(pulls))
    assert edits is not None
    return edits, state


def applied(subject: Gaussians, edits: Edits) -> Gaussians:
    kept = subject if edits.keep is None else subject[edits.keep]
    return kept if edits.append is None else concatenate([kept, edits.append])


def names(subject: Gaussians) -> list[int]:
    return [int(v) for v in subject.sh0[:, 0, 0]]


def test_clones_small_splits_large_prunes_clear() -> None:
    subject = gaussians(
        (SMALL, OPAQUE),
        (SMALL, OPAQUE),
        (LARGE, OPAQUE),
        (LARGE, OPAQUE),
        (SMALL, CLEAR),
        (LARGE, CLEAR),
    )
    edits, state = densify(subject, [1e-3, 1e-5, 1e-3, 1e-5, 1e-3, 1e-3])
    assert edits.keep is not None and edits.append is not None
    assert edits.keep.tolist() == [True, True, False, True, False, False]
    assert names(edits.append) == [0, 2, 2]
    assert edits.opacity_ceiling is None
    assert len(applied(subject, edits)) == len(state.total) == 6
    assert (state.total == 0).all() and (state.seen == 0).all()


def test_split_children_are_smaller_and_drawn_from_the_parent() -> None:
    """Over many parents the children have the parent's mean and covariance, scales / 1.6."""
    n, half = 4000, math.sqrt(0.5)
    quats = torch.tensor([[half, 0.0, 0.0, half]]).repeat(n, 1)  # a quarter turn about z
    subject = gaussians((LARGE, OPAQUE)).map(lambda t: t.repeat(n, *[1] * (t.dim() - 1)))
    subject = subject.replace(quats=quats)
    edits, _ = densify(subject, [1e-3] * n)
    children = edits.append
    assert children is not None and len(children) == 2 * n
    torch.testing.assert_close(children.scales * 1.6, subject.scales.repeat(2, 1))
    torch.testing.assert_close(children.opacity_logits, subject.opacity_logits.repeat(2))
    spread = children.means.double()
    assert spread.mean(0).abs().max() < 4 * LARGE / math.sqrt(2 * n)
    deviations = torch.tensor([0.5, 1.0, 0.1], dtype=torch.float64) * LARGE  # x and y swapped
    torch.testing.assert_close(spread.T.cov().diagonal().sqrt(), deviations, rtol=0.04, atol=0)
    assert not torch.equal(children.means[:n], children.means[n:])


def test_pull_is_the_mean_over_the_steps_that_saw_it_in_ndc() -> None:
    subject, adc = gaussians((SMALL, OPAQUE), (SMALL, OPAQUE)), AdaptiveDensityControl()
    ctx = context(subject, 1)
    state = adc.init_state(ctx)
    gradient = torch.tensor([[3e-6, 8e-6], [1.0, 1.0]])
    edits, state = adc.update(ctx, state, StepStats(gradient, torch.tensor([2.0, 0.0]), 200, 100))
    gradient = torch.tensor([[0.0, 0.0], [0.0, 0.0]])
    _, state = adc.update(ctx, state, StepStats(gradient, torch.tensor([2.0, 0.0]), 100, 50))
    assert edits is None
    expected = math.hypot(3e-6 * 100, 8e-6 * 50) / 2
    torch.testing.assert_close(state.mean, torch.tensor([expected, 0.0]))


def test_what_is_dropped_may_count_as_seen() -> None:
    """As in DropGaussian's code, where it has a radius and no gradient."""
    step = StepStats(
        means2d_grad=torch.tensor([[0.03, 0.0], [0.0, 0.0], [0.0, 0.0], [0.0, 0.0]]),
        radii=torch.tensor([1.0, 1.0, 1.0, 0.0]),
        width=WIDTH,
        height=HEIGHT,
        factors=torch.tensor([1.25, 1.25, 0.3, 0.0]),
    )
    for counted, seen in ((False, 1.0), (True, 4 / 3)):
        plugin = AdaptiveDensityControl(count_dropped=counted)
        pull = plugin.measured(plugin.unmeasured(4), step)
        assert torch.allclose(pull.seen, torch.tensor([seen, seen, seen, 0.0]))
        assert float(pull.mean[0]) == pytest.approx(0.03 * WIDTH / 2 / seen)


def test_pull_does_not_depend_on_the_resolution() -> None:
    """A loss of the same image at half the size has twice the gradient per pixel."""
    subject, adc = gaussians((SMALL, OPAQUE)), AdaptiveDensityControl()
    ctx, gradient = context(subject, 1), torch.tensor([[3e-6, 4e-6]])
    start, radii = adc.init_state(ctx), torch.ones(1)
    _, full = adc.update(ctx, start, StepStats(gradient, radii, 200, 100))
    _, half = adc.update(ctx, start, StepStats(2 * gradient, radii, 100, 50))
    torch.testing.assert_close(full.mean, half.mean)


def test_steps_of_another_length_are_in_proportion() -> None:
    """10,000 steps: every 1,000 after 2,000, as every 100 after 200 in 1,000; at least an epoch."""
    adc, subject = AdaptiveDensityControl(of_steps=1000, from_step=200), gaussians((SMALL, OPAQUE))

    def due(finished: int, n_views: int) -> bool:
        ctx = replace(context(subject, finished), views=(None,) * n_views)  # type: ignore[arg-type]
        edits, _ = adc.update(ctx, adc.init_state(ctx), stats([1e-3]))
        return edits is not None

    assert [due(n, 3) for n in (600, 1000, 2000, 3000, 3500, 4000)] == [False] * 3 + [
        *(True, False, True)
    ]
    assert not due(3000, 1100) and due(3300, 1100)


def test_resets_opacities_and_densifies_at_the_same_step() -> None:
    subject, adc = gaussians((SMALL, OPAQUE)), AdaptiveDensityControl()
    ctx = context(subject, 3000)
    edits, _ = adc.update(ctx, adc.init_state(ctx), stats([1e-3]))
    assert edits is not None and edits.opacity_ceiling == 0.01 and edits.append is not None
    alone = AdaptiveDensityControl(every=700)
    edits, state = alone.update(ctx, alone.init_state(ctx), stats([1e-3]))
    assert edits == Edits(opacity_ceiling=0.01)
    assert state.seen.tolist() == [1.0]


def test_absolute_pulls_count_where_they_are_asked_for() -> None:
    subject = gaussians((SMALL, OPAQUE), (SMALL, OPAQUE))
    measured = replace(stats([1e-3, 1e-5]), absolute=stats([1e-5, 1e-3]).means2d_grad)
    for absolute in (False, True):
        adc = AdaptiveDensityControl(absolute=absolute)
        assert adc.wants_absolute() == absolute
        ctx = context(subject, 600)
        edits, _ = adc.update(ctx, adc.init_state(ctx), measured)
        assert edits is not None and edits.append is not None
        assert names(edits.append) == [int(absolute)]


def test_max_gaussians_serves_the_strongest_pulled() -> None:
    subject = gaussians(*[(SMALL, OPAQUE)] * 4, (SMALL, CLEAR))
    edits, _ = densify(subject, [1e-3, 4e-3, 2e-3, 3e-3, 9e-3], max_gaussians=6)
    assert edits.append is not None and names(edits.append) == [1, 3]
    full, _ = densify(subject, [1e-3, 4e-3, 2e-3, 3e-3, 9e-3], max_gaussians=2)
    assert full.append is not None and len(full.append) == 0


def test_same_seed_same_children_and_inputs_unmutated() -> None:
    subject = gaussians((LARGE, OPAQUE), (SMALL, OPAQUE))
    before = subject.clone()
    adc, ctx = AdaptiveDensityControl(), context(subject, 600)
    state, measured = adc.init_state(ctx), stats([1e-3, 1e-3])
    first, _ = adc.update(ctx, state, measured)
    again, _ = adc.update(ctx, state, measured)
    other, _ = densify(subject, [1e-3, 1e-3], seed=1)
    assert first is not None and again is not None
    means = [edits.append.means for edits in (first, again, other) if edits.append is not None]
    assert torch.equal(means[0], means[1]) and not torch.equal(means[0], means[2])
    assert all(torch.equal(t, getattr(before, k)) for k, t in subject.items())
    assert (state.total == 0).all() and torch.equal(
        measured.means2d_grad, stats([1e-3] * 2).means2d_grad
    )


def test_statistics_of_another_set_are_refused() -> None:
    subject, adc = gaussians((SMALL, OPAQUE)), AdaptiveDensityControl()
    ctx = context(subject, 600)
    with pytest.raises(ValueError, match=r"expected step statistics of 1 Gaussians .* got 2"):
        adc.update(ctx, adc.init_state(ctx), stats([0.0, 0.0]))


def test_is_chosen_by_name_and_checks_its_options() -> None:
    plugged = build("capacity", {"name": "adc", "max_gaussians": 5000})
    assert plugged.plugin == replace(AdaptiveDensityControl(), max_gaussians=5000)
    assert (plugged.start, plugged.stop) == (0.0, 0.9)
    with pytest.raises(UserError, match=r"capacity.every: expected an integer >= 1, got 0"):
        build("capacity", {"name": "adc", "every": 0})
    with pytest.raises(UserError, match=r"capacity.reset_opacity: expected a number in \(min_op"):
        build("capacity", {"name": "adc", "reset_opacity": 0.001})
