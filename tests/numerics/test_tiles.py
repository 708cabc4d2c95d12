"""Which tiles a Gaussian touches, against a scalar twin, and never more than its box covers."""

import math
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from framework.compute.rng import stream
from framework.kernels import Arrays, Workspace
from framework.kernels.tile import binning
from framework.types import Camera, Gaussians

f4 = np.float32
GUARD = -7
BLOCKS = 16
SIZES = ((37, 53), (100, 120), (16, 16), (504, 20), (5, 3))


def _edge(at: Any, x0: Any, x1: Any, row: np.ndarray, sign: int) -> Any:
    """The extreme dy of the ellipse in the columns x0 ... x1 of dx, see `binning._edge`."""
    rx, ry = row[10], row[11]
    dx = max(-rx, min(rx, max(x0, min(x1, at))))
    share = dx * (f4(1) / rx)
    level = -(row[5] + f4(math.log2(255))) / row[4]
    inside = level * (f4(1) - share * share)
    root = np.sqrt(inside) if inside > 0 else f4(0)  # also where rx = 0
    return max(-ry, min(ry, f4(sign) * root - row[15] * dx))


def _tiles(row: np.ndarray, width: int, height: int) -> list[tuple[int, int, int]]:
    """(tile, first row, last row) in the order of the lists."""
    u, v, rx, ry = row[0], row[1], row[10], row[11]
    left = max(0, math.ceil(u - rx - f4(0.5)))
    right = min(width - 1, math.floor(u + rx - f4(0.5)))
    summit = f4(-0.5) * row[3] / row[2] * ry
    actual = []
    for column in range(left // 16, right // 16 + 1):
        x0 = f4(column * 16) + f4(0.5) - u
        x1 = x0 + f4(15)
        top = max(0, math.ceil(v + _edge(-summit, x0, x1, row, -1) - f4(0.5)))
        low = math.floor(v + _edge(summit, x0, x1, row, 1) - f4(0.5))
        bottom = min(height - 1, low)
        if top > bottom:
            continue
        for band in range(top // 16, bottom // 16 + 1):
            tile = band * ((width + 15) // 16) + column
            actual.append((tile, max(0, top - 16 * band), min(15, bottom - 16 * band)))
    return actual


def _camera(width: int, height: int) -> Camera:
    K = torch.tensor([[90.0, 0, width / 2 + 0.5], [0, 80, height / 2 + 0.5], [0, 0, 1]])
    return Camera(torch.eye(4), K, width, height)


def _counted(gaussians: Gaussians, camera: Camera, factors: Tensor) -> Workspace:
    """A workspace whose lists are made; nothing was written where `items` begins to end."""
    n, work = len(gaussians), Workspace()
    arrays = [t.detach().contiguous().numpy() for _, t in gaussians.items()]
    arrays += [factors.numpy(), np.zeros((n, 2), np.float32)]
    work.project(Arrays(*arrays), camera, 0, 0.01, np.empty(n, np.float32))
    work.sort()
    items = int(work.start[work.n_visible])
    work.items = np.full(items + 64, GUARD, np.int32)
    for block in range(BLOCKS):
        n, size = work.n_visible, (work.width, work.height)
        listed = work.order, work.start, work.touched, work.n_parts
        binning.count_tiles(
            block, BLOCKS, n, size, work.rows, work.strips, work.items, listed, work.counts
        )
    assert (work.items[items:] == GUARD).all()
    return work


def _check(work: Workspace) -> None:
    for k in range(work.n_visible):
        start, touched = work.start[k], work.touched[k]
        assert touched <= work.start[k + 1] - start
        items = [int(item) for item in work.items[start : start + touched]]
        actual = [(item >> 9, item & 15, item >> 4 & 15) for item in items]
        with np.errstate(divide="ignore", invalid="ignore"):
            assert actual == _tiles(work.rows[work.order[k]], work.width, work.height)


@pytest.mark.parametrize("size", SIZES, ids=lambda size: f"{size[0]}x{size[1]}")
@pytest.mark.parametrize("n", [1, 15, 300])
def test_every_gaussian_has_the_tiles_of_the_scalar_twin(size: tuple[int, int], n: int) -> None:
    """From specks to ellipses many times as long as the image, of any slope."""
    rng = stream(size[0] + n, "test-tiles")
    spread = np.exp(rng.uniform(-8, 4, (n, 3)))
    gaussians = Gaussians(
        means=torch.from_numpy(rng.uniform([-1, -1, 1], [1, 1, 4], (n, 3))).float(),
        quats=torch.from_numpy(rng.standard_normal((n, 4))).float(),
        log_scales=torch.from_numpy(np.log(spread)).float(),
        opacity_logits=torch.from_numpy(rng.uniform(-5.6, 6, n)).float(),
        sh0=torch.zeros(n, 1, 3),
        shN=torch.zeros(n, 0, 3),
    )
    work = _counted(gaussians, _camera(*size), torch.ones(n))
    assert work.n_visible > 0 or n < 300
    _check(work)


def test_one_as_faint_as_can_be_seen_touches_one_tile() -> None:
    """Its ellipse is a point: 0 / 0 must not become the whole column."""
    n, least = 40, f4(1 / 255)
    factors = [least]
    for _ in range(n - 1):
        factors.append(np.nextafter(factors[-1], f4(1)))
    gaussians = Gaussians(
        means=torch.tensor([[0.0, 0.0, 4.0]]).repeat(n, 1),
        quats=torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(n, 1),
        log_scales=torch.full((n, 3), -3.0),
        opacity_logits=torch.full((n,), 40.0),
        sh0=torch.zeros(n, 1, 3),
        shN=torch.zeros(n, 0, 3),
    )
    work = _counted(gaussians, _camera(100, 120), torch.tensor(np.array(factors)))
    assert work.n_visible == n and (work.rows[:, 10] == 0).any()
    assert (work.touched[:n] == 1).all()
    _check(work)
