"""The Fisher information of `information` in torch, on any device: for rasterizers without numba.

The sums over pairs are those of `kernels.tile.moments` and `kernels.project.information`, whose
equations stand there: with q = sum over channels of (alpha dC / d alpha)^2 and m = (1, dx, e, dx^2,
dx e, e^2), e = dy + (B / C) dx, every Gaussian has Q = sum q m m^T, h_c = sum weight J_c m and
W = sum weight^2, and with K = d(u, v, A, B, C) / d(parameters) and d(alpha) / d(u, ...) = alpha L m

    F = K^T L Q L^T K + sum_c (K^T L h_c v_c^T + v_c h_c^T L^T K) + W sum_c v_c v_c^T

Pairs are in float32, tile by tile, as in the kernels; K and F, a few numbers per Gaussian, in
float64. Sums are made in a fixed order: the same input gives the same bits, on a GPU too.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from framework.fisher.information import FisherInformation, counted
from framework.kernels.constants import ALPHA_MAX, ALPHA_MIN, TILE, TRANSMITTANCE_MIN
from framework.kernels.reference import Footprints, project, sh_basis
from framework.types import Camera, Gaussians

PAIRS = {"cpu": 2**20, "cuda": 2**24}  # of a Gaussian and a pixel at once; 60 numbers for each
POWERS = [(i, order - i) for order in range(5) for i in range(order, -1, -1)]  # of dx and e
MEMBERS = [(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)]  # of m


@dataclass(frozen=True)
class _Lists:
    """Which of M footprints are on which tile: E entries, tile by tile, in each front to back.

    footprint [E] · start [tiles + 1], of each tile's entries · by_footprint [E]: the entries in
    the footprints' order · counts [M]: entries of each.
    """

    footprint: Tensor
    start: Tensor
    by_footprint: Tensor
    counts: Tensor


def fisher_in_torch(
    gaussians: Gaussians,
    camera: Camera,
    *,
    background: Tensor | None = None,
    sh_degree: int | None = None,
    near: float = 0.01,
    mask: Tensor | None = None,
) -> FisherInformation:
    """As `information.fisher_information`; the result is on the CPU, the work where `gaussians`
    are."""
    shown = None if mask is None else counted(mask, camera).to(gaussians.means.device) > 0.5
    exact = gaussians.map(lambda t: t.detach().double().requires_grad_())
    n, degree = len(gaussians), gaussians.active_degree(sh_degree)
    with torch.enable_grad():
        seen = project(exact, camera, degree, near=near)
        if len(seen.index) == 0:
            return FisherInformation(
                torch.zeros(n, 6, 6), torch.zeros(n, 14), torch.zeros(n, dtype=torch.bool)
            )
        conics = _conics(seen.cov2d)
        screen = torch.cat([seen.means2d, conics], 1)
        jacobian = _rows_of_gradient(screen, [exact.means, exact.log_scales, exact.quats])
        jacobian = jacobian[seen.index]  # [M, 5, 10]
        slopes = torch.zeros_like(jacobian[:, :3, :3])
        if degree > 0:
            slopes = _rows_of_gradient(seen.colors, [exact.means])[seen.index]
    on_screen = seen.radii(camera.width, camera.height) > 0
    moments, through_colour, weights = _sums(seen, conics.detach(), camera, background, shown)
    block, turns = _pulled_back(conics.detach(), jacobian, slopes, moments, through_colour, weights)
    logit_slope = 1 - exact.opacities.detach()[seen.index]
    shown = (seen.colors.detach() > 0) * weights[:, None]
    item = torch.cat(
        [
            block.diagonal(dim1=1, dim2=2),
            turns,
            (logit_slope**2 * moments[:, 0, 0])[:, None],
            sh_basis(seen.colors.new_tensor([[0.0, 0.0, 1.0]]), 0) ** 2 * shown,
        ],
        1,
    )
    rows = seen.index
    blocks = block.new_zeros(n, 6, 6).index_copy(0, rows, block)
    diagonal = item.new_zeros(n, 14).index_copy(0, rows, item.clamp(min=0))
    visible = torch.zeros(n, dtype=torch.bool, device=rows.device)
    visible = visible.index_copy(0, rows, on_screen)
    return FisherInformation(blocks.float().cpu(), diagonal.float().cpu(), visible.cpu())


def _conics(cov2d: Tensor) -> Tensor:
    """[M, 3] A, B, C of the inverses of [M, 2, 2]."""
    a, b, c = cov2d[:, 0, 0], cov2d[:, 0, 1], cov2d[:, 1, 1]
    return torch.stack([c, -b, a], 1) / (a * c - b * b)[:, None]


def _rows_of_gradient(outputs: Tensor, inputs: list[Tensor]) -> Tensor:
    """[N, D, P]: the derivative of every Gaussian's D outputs in its own P inputs, beside each
    other; no output depends on another Gaussian's. All outputs in one pass."""
    n, d = outputs.shape
    each = torch.eye(d).to(outputs)[:, None].expand(d, n, d)
    parts = torch.autograd.grad(
        outputs, inputs, each, retain_graph=True, is_grads_batched=True, materialize_grads=True
    )
    return torch.cat(parts, 2).transpose(0, 1)


def _lists(seen: Footprints, camera: Camera) -> _Lists:
    """The tiles that hold a pixel centre of each footprint's box."""
    _, first, last = (t.detach() for t in seen.boxes(camera.width, camera.height))
    first_tile, last_tile = ((t / TILE).floor().long() for t in (first, last))
    on_screen = (first <= last).all(dim=1)
    across, down = torch.where(on_screen[:, None], last_tile - first_tile + 1, 0).unbind(1)
    counts = across * down
    owner = torch.repeat_interleave(torch.arange(len(counts), device=counts.device), counts)
    place = torch.arange(len(owner), device=counts.device) - (counts.cumsum(0) - counts)[owner]
    columns, rows = -(-camera.width // TILE), -(-camera.height // TILE)
    tile = (first_tile[owner, 1] + place // across[owner]) * columns
    tile = tile + first_tile[owner, 0] + place % across[owner]
    order = torch.argsort(tile, stable=True)
    start = torch.searchsorted(tile[order], torch.arange(columns * rows + 1, device=tile.device))
    back = torch.empty_like(order)
    back[order] = torch.arange(len(order), device=order.device)
    return _Lists(owner[order], start, back, counts)


def _batches(start: Tensor, pairs: int) -> Iterator[tuple[Tensor, int]]:
    """Tiles that are worked on at once, and how long the longest list of them is; the longest
    first, as tiles of like length waste no room."""
    lengths = start.diff()
    order = torch.argsort(lengths, descending=True, stable=True)
    sizes, at = lengths[order].tolist(), 0
    while at < len(sizes) and sizes[at] > 0:
        n = max(1, pairs // (TILE * TILE * sizes[at]))
        yield order[at : at + n], sizes[at]
        at += n


def _sums(
    seen: Footprints,
    conics: Tensor,
    camera: Camera,
    background: Tensor | None,
    shown: Tensor | None,
) -> tuple[Tensor, Tensor, Tensor]:
    """Q [M, 6, 6], h [M, 3, 6] and W [M] of all footprints, float64."""
    lists = _lists(seen, camera)
    device = conics.device
    # along e = dy + (B / C) dx and across it the exponent is a sum of squares: with A, B and C
    # themselves that of a needle is a small difference of large numbers
    lean, narrow = conics[:, 1] / conics[:, 2], 1 / seen.cov2d[:, 0, 0]
    shape = torch.stack([lean, narrow, conics[:, 2]], 1)
    columns = [seen.means2d, shape, seen.opacities[:, None], seen.colors]
    flat = torch.cat(columns, 1).detach().float()
    flat = torch.cat([flat, flat.new_zeros(1, flat.shape[1])])  # an entry that fills up a list
    behind = flat.new_zeros(3) if background is None else background.to(flat)
    result = flat.new_zeros(len(lists.footprint), len(POWERS) + 3 * len(MEMBERS) + 1)
    across = -(-camera.width // TILE)
    for tiles, longest in _batches(lists.start, PAIRS.get(device.type, PAIRS["cuda"])):
        places = lists.start[tiles][:, None] + torch.arange(longest, device=device)
        real = places < lists.start[tiles + 1][:, None]
        places = places.clamp(max=len(lists.footprint) - 1)
        rows = torch.where(real, lists.footprint[places], len(flat) - 1)
        corner = torch.stack([tiles % across, tiles // across], 1) * TILE
        result[places[real]] = _tile_sums(flat[rows], corner, camera, behind, shown)[real]
    per_footprint = torch.segment_reduce(
        result[lists.by_footprint], "sum", lengths=lists.counts, initial=0
    ).double()
    at = {power: k for k, power in enumerate(POWERS)}
    pick = [[at[i + k, j + m] for k, m in MEMBERS] for i, j in MEMBERS]
    n = len(POWERS)
    through = per_footprint[:, n:-1].reshape(-1, 3, len(MEMBERS))
    return per_footprint[:, pick], through, per_footprint[:, -1]


def _tile_sums(
    rows: Tensor, corner: Tensor, camera: Camera, background: Tensor, shown: Tensor | None
) -> Tensor:
    """[B, K, 34]: sums over a tile's pixels of q dx^i e^j, of weight J_c m and of weight^2.

    rows [B, K, 9]: u, v, B / C, A - B^2 / C, C, opacity, colour of the tiles' lists. corner
    [B, 2]: pixels. shown [H, W] bool: those that count, or None: all."""
    side = torch.arange(TILE, device=rows.device)
    xs, ys = corner[:, :1] + side, corner[:, 1:] + side
    inside = ((ys < camera.height)[:, :, None] & (xs < camera.width)[:, None, :]).flatten(1)
    if shown is not None:
        columns, lines = xs.clamp(max=camera.width - 1), ys.clamp(max=camera.height - 1)
        inside &= shown[lines[:, :, None], columns[:, None, :]].flatten(1)
    x = (xs + 0.5).to(rows)[:, None, :].expand(-1, TILE, -1).flatten(1)
    y = (ys + 0.5).to(rows)[:, :, None].expand(-1, -1, TILE).flatten(1)
    u, v, lean, narrow, c, opacity, red, green, blue = (t[..., None] for t in rows.unbind(2))
    dx, dy = x[:, None, :] - u, y[:, None, :] - v
    e = dy + lean * dx
    falloff = (-0.5 * (narrow * dx * dx + c * e * e)).exp()
    raw = torch.where(inside[:, None, :], opacity * falloff, 0.0)
    alpha = torch.where(raw >= ALPHA_MIN, raw.clamp(max=ALPHA_MAX), 0.0)
    after = (1 - alpha).cumprod(1)
    alpha = torch.where(after >= TRANSMITTANCE_MIN, alpha, 0.0)
    after = (1 - alpha).cumprod(1)
    before = torch.cat([torch.ones_like(after[:, :1]), after[:, :-1]], 1)
    weight = alpha * before
    odds = torch.where(raw > ALPHA_MAX, 0.0, alpha / (1 - alpha))
    steps = []  # alpha dC / d alpha of each channel
    for channel, colour in enumerate((red, green, blue)):
        values = weight * colour
        rest = values.flip(1).cumsum(1).flip(1) + background[channel] * after[:, -1:]
        steps.append(odds * (before * colour - rest))
    q = steps[0] ** 2 + steps[1] ** 2 + steps[2] ** 2
    dx_powers, e_powers = [torch.ones_like(dx), dx], [torch.ones_like(e), e]
    for _ in range(3):
        dx_powers.append(dx_powers[-1] * dx)
        e_powers.append(e_powers[-1] * e)
    sums = [(q * dx_powers[i] * e_powers[j]).sum(2) for i, j in POWERS]
    for step in steps:
        pull = weight * step
        sums += [(pull * dx_powers[i] * e_powers[j]).sum(2) for i, j in MEMBERS]
    return torch.stack([*sums, (weight * weight).sum(2)], 2)


def _pulled_back(
    conics: Tensor,
    jacobian: Tensor,
    slopes: Tensor,
    moments: Tensor,
    through_colour: Tensor,
    weights: Tensor,
) -> tuple[Tensor, Tensor]:
    """Block [M, 6, 6] in (mean, log-scale) and diagonal [M, 4] in the quat."""
    a, b, c = conics.unbind(1)
    s, zero, one = b / c, torch.zeros_like(a), torch.ones_like(a)
    rows = (  # d(alpha) / d(u, v, A, B, C) / alpha, in (dx, e, dx^2, dx e, e^2)
        (a - b * s, b, zero, zero, zero),
        (zero, c, zero, zero, zero),
        (zero, zero, -one / 2, zero, zero),
        (zero, zero, s, -one, zero),
        (zero, zero, -s * s / 2, s, -one / 2),
    )
    screen = torch.stack([torch.stack(row, 1) for row in rows], 1)  # L [M, 5, 5]
    both = screen.mT @ jacobian  # L^T K [M, 5, 10]
    whole = both.mT @ moments[:, 1:, 1:] @ both
    block = whole[:, :6, :6].clone()
    turned = through_colour[:, :, 1:] @ both[:, :, :6]  # h_c^T L^T K [M, 3, 6]
    mixed = slopes.mT @ turned  # sum_c v_c h_c^T L^T K [M, 3, 6]
    block[:, :3] += mixed
    block[:, :, :3] += mixed.mT
    block[:, :3, :3] += weights[:, None, None] * (slopes.mT @ slopes)
    return block, whole.diagonal(dim1=1, dim2=2)[:, 6:]
