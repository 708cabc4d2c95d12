"""Alpha from row to row by multiplications (`tiles.first_alphas`), beside the exponential."""

from typing import Any

import numpy as np
import pytest
import torch

from framework.compute.jit import kernel
from framework.compute.rng import stream
from framework.compute.simd import store
from framework.kernels import Arrays, Workspace
from framework.kernels.constants import ALPHA_MIN
from framework.kernels.tile.tiles import first_alphas, next_run, run_of, seen_from
from framework.types import Camera

N = 3000
TILES = ((0, 0), (16, 0), (0, 16), (16, 16))


@kernel
def _alphas(rows: Any, g: int, x: int, y: int, out: Any) -> int:
    """Gaussian g in the tile at (x, y), into out (flat [16 16]); returns the longest run."""
    placed = seen_from(rows, g, x, y)
    bend, longest, lean = run_of(rows, g)
    todo = 65535
    while todo != 0:
        row, count, todo = next_run(todo, longest)
        alpha, ratio = first_alphas(placed, lean, row, count)
        for at in range(row * 16, (row + count) * 16, 16):
            store(out, at, alpha)
            alpha, ratio = alpha * ratio, ratio * bend
    return longest


def _projected(factor: float) -> np.ndarray:
    """Rows [N, 16] of Gaussians over 32x32 pixels: from a hundredth of a pixel to a hundred of them
    long and wide, at all angles; factor: of their opacities."""
    rng = stream(0, "test-runs")
    pixel = 1 / 100  # at depth 1
    means = np.column_stack([rng.uniform(-0.2, 0.2, (N, 2)), np.ones(N)])
    turn = rng.uniform(0, np.pi, N)
    quats = np.column_stack([np.cos(turn / 2), 0 * turn, 0 * turn, np.sin(turn / 2)])
    scales = np.log(10 ** rng.uniform(-2, 2, (N, 3)) * pixel)
    shapes = (means, quats, scales, rng.uniform(-5, 6, N), np.zeros((N, 1, 3)))
    arrays = [np.ascontiguousarray(values, np.float32) for values in shapes]
    arrays += [
        np.zeros((0, 0, 3), np.float32),
        np.full(N, factor, np.float32),
        np.zeros((N, 2), np.float32),
    ]
    K = torch.tensor([[100.0, 0, 16], [0, 100, 16], [0, 0, 1]])
    work = Workspace()
    work.project(Arrays(*arrays), Camera(torch.eye(4), K, 32, 32), 0, 0.01, np.empty(N, np.float32))
    return work.rows[work.bound > 0]


def _exact(row: np.ndarray, x: int, y: int) -> np.ndarray:
    """[16, 16] of the same numbers in float64."""
    u, v, a, b, c, peak = row[:6].astype(np.float64)
    dx = x + np.arange(16) + 0.5 - u
    dy = (y + np.arange(16) + 0.5 - v)[:, None]
    return np.exp2(peak + a * dx * dx + b * dx * dy + c * dy * dy)


@pytest.mark.parametrize("factor", [1.0, 1000.0])
def test_rows_of_any_gaussian_follow_the_exponential(factor: float) -> None:
    """Where a pixel blends, alpha is right; elsewhere it is too small to blend; and nowhere is it
    below float32's normal range, where multiplications are slow."""
    rows, out = _projected(factor), np.empty(256, np.float32)
    assert len(rows) > 2000 and (rows[:, 12].max() > 0.99 * factor)
    runs, blended = set(), 0
    for g, row in enumerate(rows):
        for x, y in TILES:
            runs.add(_alphas(rows, g, x, y, out))
            ours, exact = out.reshape(16, 16).astype(np.float64), _exact(row, x, y)
            near = exact >= ALPHA_MIN
            blended += near.sum()
            # the exponent's terms cancel along needles: up to 540 in float32
            np.testing.assert_allclose(ours[near], exact[near], rtol=1e-3)
            assert (ours[~near] < ALPHA_MIN * (1 + 1e-3)).all()
            assert ((ours == 0) | (ours >= np.finfo(np.float32).tiny)).all()
    if factor == 1:
        assert {5, 16} <= runs <= set(range(5, 17))  # from the narrowest, dilated, to the widest
    assert blended > 100_000
