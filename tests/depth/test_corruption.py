"""Depth made worse on purpose: the identity at 0, the stated error at 1, the same draws again."""

import numpy as np
import pytest
import torch

from framework.depth.corruption import BLUR_LENGTH, NOISE, corrupt
from framework.depth.options import CORRUPTIONS
from framework.types import DepthMap
from tests.built import build_provider
from tests.depth.plane import plane_scene

SIZE = (150, 200)


def step_maps(n: int = 3) -> tuple[DepthMap, ...]:
    """Depth 2 on the left, 6 on the right, an unknown top row; confidence 0.7 where known."""
    depth = torch.full(SIZE, 2.0)
    depth[:, 100:] = 6.0
    depth[0] = 0.0
    return tuple(DepthMap(depth.clone(), 0.7 * (depth > 0)) for _ in range(n))


def log_errors(kind: str, strength: float, seed: int = 0) -> list[np.ndarray]:
    clean = step_maps()
    spoiled = corrupt(clean, [kind], strength, seed)
    return [
        np.log(s.depth.numpy()[1:] / c.depth.numpy()[1:])
        for s, c in zip(spoiled, clean, strict=True)
    ]


@pytest.mark.parametrize("kind", [*CORRUPTIONS, "noise+bias+holes+blur"])
def test_strength_0_is_the_identity_bit_for_bit(kind: str) -> None:
    plain = build_provider("ground_truth", {}).estimate(plane_scene())
    zero = build_provider("ground_truth", {"corruption": kind, "strength": 0.0})
    for a, b in zip(plain, zero.estimate(plane_scene()), strict=True):
        assert torch.equal(a.depth, b.depth) and torch.equal(a.confidence, b.confidence)


@pytest.mark.parametrize("kind", CORRUPTIONS)
def test_same_seed_same_bits_and_inputs_stay(kind: str) -> None:
    clean, before = step_maps(), step_maps()
    first, again = corrupt(clean, [kind], 0.6, 3), corrupt(clean, [kind], 0.6, 3)
    assert any(not torch.equal(a.depth, b.depth) for a, b in zip(first, clean, strict=True))
    for a, b, now, then in zip(first, again, clean, before, strict=True):
        assert torch.equal(a.depth, b.depth) and torch.equal(a.confidence, b.confidence)
        assert torch.equal(now.depth, then.depth) and torch.equal(now.confidence, then.confidence)
        assert a.depth.dtype == a.confidence.dtype == torch.float32
        assert float(a.depth[0].abs().max()) == 0  # unknown stays unknown


def test_noise_has_the_stated_deviation_and_grows_with_the_strength() -> None:
    full, half = log_errors("noise", 1.0), log_errors("noise", 0.5)
    deviation = np.sqrt(np.mean(np.square(full)))
    assert deviation == pytest.approx(NOISE, rel=0.1)
    np.testing.assert_allclose(np.stack(half), 0.5 * np.stack(full), atol=1e-6)
    assert not np.allclose(full[0], full[1])


def test_blur_spreads_the_edge_alone() -> None:
    spoiled = corrupt(step_maps(), ["blur"], 1.0, 0)[0]
    sigma_px = BLUR_LENGTH * float(np.hypot(*SIZE))
    row = spoiled.depth[75].numpy()
    assert np.all(np.diff(row) >= -1e-5)
    assert row[99] < 1 / (0.5 * (1 / 2 + 1 / 6)) < row[100]  # inverse depth meets in the middle
    away = np.abs(np.arange(200) - 99.5) > 5 * sigma_px
    np.testing.assert_allclose(row[away], step_maps()[0].depth[75].numpy()[away], rtol=1e-4)
    assert torch.equal(spoiled.confidence, step_maps()[0].confidence)
