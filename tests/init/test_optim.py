"""Adam against torch.optim.Adam, across thread counts, and through changes of the set."""

import copy
from collections.abc import Iterator

import numpy as np
import pytest
import torch

from framework.compute.parallel import set_threads
from framework.compute.rng import stream
from framework.train.optim import Adam
from framework.types import Gaussians

RATES = {
    "means": 1e-3,
    "quats": 1e-3,
    "log_scales": 5e-3,
    "opacity_logits": 0.05,
    "sh0": 2.5e-3,
    "shN": 1.25e-4,
}


@pytest.fixture(autouse=True)
def _restore_threads() -> Iterator[None]:
    yield
    set_threads(0)


def gaussians(n: int, purpose: str, step: int = 0, n_rest: int = 3) -> Gaussians:
    rng = stream(1, purpose, step)
    shapes = {
        "means": (n, 3),
        "quats": (n, 4),
        "log_scales": (n, 3),
        "opacity_logits": (n,),
        "sh0": (n, 1, 3),
        "shN": (n, n_rest, 3),
    }
    draw = {k: rng.standard_normal(s, dtype=np.float32) for k, s in shapes.items()}
    return Gaussians(**{k: torch.from_numpy(v) for k, v in draw.items()})


def gradient(n: int, step: int, n_rest: int = 3) -> Gaussians:
    """Gradients of widely different sizes, as in training."""
    scale = 10.0 ** (-3 * (step % 3))
    return gaussians(n, "test/gradient", step, n_rest).map(lambda t: t * scale)


def trained(n: int, steps: int, threads: int) -> Gaussians:
    set_threads(threads)
    params = gaussians(n, "test/params")
    adam = Adam(params)
    for step in range(steps):
        adam.step(params, gradient(n, step), RATES)
    return params


def equal(a: Gaussians, b: Gaussians) -> bool:
    return all(torch.equal(x, y) for (_, x), (_, y) in zip(a.items(), b.items(), strict=True))


def test_agrees_with_torch_in_float64() -> None:
    ours = trained(101, 30, threads=2)
    theirs = gaussians(101, "test/params").map(lambda t: t.double().requires_grad_())
    groups = [{"params": [t], "lr": RATES[name]} for name, t in theirs.items()]
    optimizer = torch.optim.Adam(groups, betas=(0.9, 0.999), eps=1e-15)
    for step in range(30):
        for (_, t), (_, g) in zip(theirs.items(), gradient(101, step).items(), strict=True):
            t.grad = g.double()
        optimizer.step()
    start = gaussians(101, "test/params")
    for name, expected in theirs.items():
        moved = (expected.detach() - getattr(start, name)).abs().mean()
        error = (getattr(ours, name) - expected.detach()).abs().max()
        assert error < 1e-6 + 1e-5 * moved, name


def test_edit_keeps_old_moments_and_starts_new_ones_at_zero() -> None:
    params = gaussians(6, "test/params")
    adam = Adam(params)
    adam.step(params, gradient(6, 0), RATES)
    before = copy.deepcopy(adam.state())
    keep = torch.tensor([True, False, True, True, False, True])
    adam.edit(keep, None, gaussians(2, "test/new"))
    after = adam.state()
    assert equal(after.first[torch.arange(4)], before.first[keep])
    assert equal(after.second[torch.arange(4)], before.second[keep])
    assert all((t[4:] == 0).all() and len(t) == 6 for _, t in after.first.items())
    params = gaussians(6, "test/params")
    adam.step(params, gradient(6, 1), RATES)
    adam.edit(None, None, None)
    assert len(adam.state().first) == 6


def test_a_loaded_state_continues_to_the_same_bits() -> None:
    straight = trained(20, 6, threads=1)
    params = gaussians(20, "test/params")
    first = Adam(params)
    for step in range(3):
        first.step(params, gradient(20, step), RATES)
    state = copy.deepcopy(first.state())
    first.step(params.clone(), gradient(20, 9), RATES)  # must not reach into the saved state
    second = Adam(params)
    second.load(state)
    for step in range(3, 6):
        second.step(params, gradient(20, step), RATES)
    assert equal(params, straight)


def test_opacity_decay_multiplies_opacities_on_any_thread_count() -> None:
    """Also where no tensor has a gradient, and after the update where they do."""
    start = torch.linspace(-12, 12, 1001)
    for grads in ({}, dict(gradient(1001, 0).items())):
        updated, results = gaussians(1001, "test/params").replace(opacity_logits=start.clone()), []
        Adam(updated).step(updated, grads, RATES)
        for threads in (1, 3):
            set_threads(threads)
            params = gaussians(1001, "test/params").replace(opacity_logits=start.clone())
            Adam(params).step(params, grads, RATES, decay=0.99)
            results.append(params)
        assert equal(*results)
        expected = 0.99 * updated.opacity_logits.sigmoid()
        torch.testing.assert_close(results[0].opacities, expected, atol=2e-7, rtol=1e-6)
        assert torch.equal(results[0].means, updated.means)
