"""Adaptive density control on hand-made Gaussians whose fate is known."""

import math
from typing import Any

import torch

from framework.compute.rng import stream
from framework.plugin import Edits, StepContext, StepStats
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


def test_resets_opacities_and_densifies_at_the_same_step() -> None:
    subject, adc = gaussians((SMALL, OPAQUE)), AdaptiveDensityControl()
    ctx = context(subject, 3000)
    edits, _ = adc.update(ctx, adc.init_state(ctx), stats([1e-3]))
    assert edits is not None and edits.opacity_ceiling == 0.01 and edits.append is not None
    alone = AdaptiveDensityControl(every=700)
    edits, state = alone.update(ctx, alone.init_state(ctx), stats([1e-3]))
    assert edits == Edits(opacity_ceiling=0.01)
    assert state.seen.tolist() == [1.0]
