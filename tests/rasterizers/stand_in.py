"""The five functions of gsplat 1.5.3 that we call, in torch: for tests where there is no CUDA.

Written after its kernels (`ProjectionEWA3DGSFused.cu`, `IntersectTile.cu`,
`RasterizeToPixels3DGSFwd.cu`), with their constants; what those leave undefined is NaN here.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import Any
from unittest.mock import patch

import torch
from torch import Tensor

from framework.geometry import rotation_matrices
from framework.rasterize.reference import sh_basis
from framework.rasterizers.on_gpu import Gsplat

ALPHA_MIN, ALPHA_MAX, LEAST_LIGHT, EXTEND = 1 / 255, 0.999, 1e-4, 3.33


class StandIn(Gsplat):
    """`rasterizer=gsplat` on the CPU, by the functions below (inside `installed`)."""

    @property
    def device(self) -> str:
        return "cpu"

    def ready(self) -> None:
        pass


@contextmanager
def installed() -> Iterator[None]:
    """These functions in the place of the package."""
    module = ModuleType("gsplat")
    for function in FUNCTIONS:
        setattr(module, function.__name__, function)
    with patch.dict(sys.modules, {"gsplat": module}):
        yield


def fully_fused_projection(
    means: Tensor,
    covars: Tensor | None,
    quats: Tensor,
    scales: Tensor,
    viewmats: Tensor,
    Ks: Tensor,
    width: int,
    height: int,
    eps2d: float = 0.3,
    near_plane: float = 0.01,
    far_plane: float = 1e10,
    radius_clip: float = 0.0,
    packed: bool = False,
    sparse_grad: bool = False,
    calc_compensations: bool = False,
    camera_model: str = "pinhole",
    opacities: Tensor | None = None,
) -> tuple[Tensor, Tensor, Tensor, Tensor, None]:
    assert covars is None and opacities is not None and not packed and not calc_compensations
    rotation, translation, K = viewmats[0, :3, :3], viewmats[0, :3, 3], Ks[0]
    points = means @ rotation.T + translation
    ahead = (points[:, 2] >= near_plane) & (points[:, 2] <= far_plane)
    x, y, z = torch.where(ahead[:, None], points, 1.0).unbind(1)
    fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    margin = [0.3 * 0.5 * width / fx, 0.3 * 0.5 * height / fy]
    tx = z * (x / z).clamp(-(cx / fx + margin[0]), (width - cx) / fx + margin[0])
    ty = z * (y / z).clamp(-(cy / fy + margin[1]), (height - cy) / fy + margin[1])
    zero = torch.zeros_like(z)
    rows = [fx / z, zero, -fx * tx / z**2, zero, fy / z, -fy * ty / z**2]
    J = torch.stack(rows, 1).reshape(-1, 2, 3)
    half = J @ rotation @ (rotation_matrices(quats) * scales[:, None, :])
    cov2d = half @ half.mT + eps2d * torch.eye(2)
    a, b, c = cov2d[:, 0, 0], cov2d[:, 0, 1], cov2d[:, 1, 1]
    conics = torch.stack([c, -b, a], 1) / (a * c - b * b)[:, None]
    means2d = torch.stack([fx * x / z + cx, fy * y / z + cy], 1)
    extend = (2 * (opacities / ALPHA_MIN).log()).clamp(min=0).sqrt().clamp(max=EXTEND)
    sides = (extend[:, None] * torch.stack([a, c], 1).sqrt()).ceil().detach()
    size = torch.tensor([width, height])
    off = (means2d + sides <= 0) | (means2d - sides >= size)
    seen = ahead & (opacities >= ALPHA_MIN) & ~off.any(1) & (sides > radius_clip).any(1)
    undefined = float("nan")
    return (
        torch.where(seen[:, None], sides, 0.0).int()[None],
        torch.where(seen[:, None], means2d, undefined)[None],
        torch.where(seen, points[:, 2], undefined)[None],
        torch.where(seen[:, None], conics, undefined)[None],
        None,
    )


@torch.no_grad()
def isect_tiles(
    means2d: Tensor,
    radii: Tensor,
    depths: Tensor,
    tile_size: int,
    tile_width: int,
    tile_height: int,
    sort: bool = True,
    segmented: bool = False,
    packed: bool = False,
    n_images: int | None = None,
    image_ids: Tensor | None = None,
    gaussian_ids: Tensor | None = None,
) -> tuple[Tensor, Tensor, Tensor]:
    ids, owners = [], []
    counts = torch.zeros(depths.shape, dtype=torch.int32)
    bits = depths[0].float().view(torch.int32).long()
    for i in (radii[0] > 0).all(1).nonzero()[:, 0].tolist():
        low = ((means2d[0, i] - radii[0, i]) / tile_size).floor().long().tolist()
        high = ((means2d[0, i] + radii[0, i]) / tile_size).ceil().long().tolist()
        for row in range(max(0, low[1]), min(tile_height, high[1])):
            for column in range(max(0, low[0]), min(tile_width, high[0])):
                ids.append((row * tile_width + column) << 32 | int(bits[i]))
                owners.append(i)
                counts[0, i] += 1
    order = torch.tensor(ids, dtype=torch.int64).sort(stable=True)
    return counts, order.values, torch.tensor(owners, dtype=torch.int32)[order.indices]


@torch.no_grad()
def isect_offset_encode(
    isect_ids: Tensor, n_images: int, tile_width: int, tile_height: int
) -> Tensor:
    tiles = torch.arange(n_images * tile_height * tile_width)
    starts = torch.searchsorted(isect_ids >> 32, tiles)
    return starts.int().reshape(n_images, tile_height, tile_width)


def rasterize_to_pixels(
    means2d: Tensor,
    conics: Tensor,
    colors: Tensor,
    opacities: Tensor,
    image_width: int,
    image_height: int,
    tile_size: int,
    isect_offsets: Tensor,
    flatten_ids: Tensor,
    backgrounds: Tensor | None = None,
    masks: Tensor | None = None,
    packed: bool = False,
    absgrad: bool = False,
) -> tuple[Tensor, Tensor]:
    assert backgrounds is not None and masks is None and not packed and len(means2d) == 1
    _, rows, columns = isect_offsets.shape
    ends = [*isect_offsets.flatten().tolist(), len(flatten_ids)]
    image = means2d.new_zeros(rows * tile_size, columns * tile_size, colors.shape[-1])
    alphas = means2d.new_zeros(rows * tile_size, columns * tile_size, 1)
    for tile in range(rows * columns):
        ids = flatten_ids[ends[tile] : ends[tile + 1]].long()
        top, left = tile // columns * tile_size, tile % columns * tile_size
        ys, xs = torch.meshgrid(
            torch.arange(tile_size) + top + 0.5, torch.arange(tile_size) + left + 0.5, indexing="ij"
        )
        dx = xs.flatten() - means2d[0, ids, 0][:, None]
        dy = ys.flatten() - means2d[0, ids, 1][:, None]
        a, b, c = conics[0, ids].T[..., None]
        sigma = 0.5 * (a * dx * dx + c * dy * dy) + b * dx * dy
        alpha = (opacities[0, ids][:, None] * (-sigma).exp()).clamp(max=ALPHA_MAX)
        alpha = torch.where((sigma >= 0) & (alpha >= ALPHA_MIN), alpha, 0.0)
        after = (1 - alpha.detach()).cumprod(0)
        alpha = torch.where(after > LEAST_LIGHT, alpha, 0.0)
        light = torch.cat([torch.ones(1, dx.shape[1]), (1 - alpha).cumprod(0)])
        shown = (alpha * light[:-1]).T @ colors[0, ids] + light[-1][:, None] * backgrounds[0]
        spot = slice(top, top + tile_size), slice(left, left + tile_size)
        image[spot] = shown.reshape(tile_size, tile_size, -1)
        alphas[spot] = (1 - light[-1]).reshape(tile_size, tile_size, 1)
    size = slice(image_height), slice(image_width)
    return image[size][None], alphas[size][None]


def spherical_harmonics(
    degrees_to_use: int, dirs: Tensor, coeffs: Tensor, masks: Tensor | None = None
) -> Tensor:
    basis = sh_basis(torch.nn.functional.normalize(dirs, dim=-1), degrees_to_use)
    shown = torch.einsum("nk,nkc->nc", basis, coeffs[:, : basis.shape[1]])
    return shown if masks is None else torch.where(masks[:, None], shown, float("nan"))


FUNCTIONS: tuple[Any, ...] = (
    *(fully_fused_projection, isect_tiles, isect_offset_encode),
    *(rasterize_to_pixels, spherical_harmonics),
)
