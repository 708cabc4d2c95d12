"""The five functions of gsplat 1.5.3 that we call, in torch: for tests where there is no CUDA.

Written after its kernels (`ProjectionEWA3DGSFused.cu`, `IntersectTile.cu`,
`RasterizeToPixels3DGSFwd.cu`), with their constants; what those leave undefined is NaN here.
"""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import Any

import torch
from torch import Tensor

from framework.backends.gsplat_gpu import Gsplat
from framework.geometry import rotation_matrices
from framework.kernels.reference import sh_basis
from tests.backends.elsewhere import DEVICE, Elsewhere

ALPHA_MIN, ALPHA_MAX, LEAST_LIGHT, EXTEND = 1 / 255, 0.999, 1e-4, 3.33


class StandIn(Gsplat):
    """`rasterizer=gsplat` on a device that only tests have, by the functions below (inside
    `installed`)."""

    @property
    def device(self) -> str:
        return DEVICE

    def ready(self) -> None:
        pass


@contextmanager
def installed() -> Iterator[None]:
    """These functions in the place of the package."""
    module = ModuleType("gsplat")
    for function in FUNCTIONS:
        setattr(module, function.__name__, function)
    before = sys.modules.get("gsplat")
    sys.modules["gsplat"] = module
    try:
        with Elsewhere():
            yield
    finally:
        del sys.modules["gsplat"]
        if before is not None:
            sys.modules["gsplat"] = before


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
    cov2d = half @ half.mT + eps2d * torch.eye(2).to(means)
    a, b, c = cov2d[:, 0, 0], cov2d[:, 0, 1], cov2d[:, 1, 1]
    conics = torch.stack([c, -b, a], 1) / (a * c - b * b)[:, None]
    means2d = torch.stack([fx * x / z + cx, fy * y / z + cy], 1)
    extend = (2 * (opacities / ALPHA_MIN).log()).clamp(min=0).sqrt().clamp(max=EXTEND)
    sides = (extend[:, None] * torch.stack([a, c], 1).sqrt()).ceil().detach()
    size = torch.tensor([width, height]).to(means.device)
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
    bits = depths[0].float().cpu().view(torch.int32).tolist()
    low = ((means2d[0] - radii[0]) / tile_size).nan_to_num().floor().long().tolist()
    high = ((means2d[0] + radii[0]) / tile_size).nan_to_num().ceil().long().tolist()
    ids, counts = [], [0] * len(bits)
    for i, sides in enumerate(radii[0].tolist()):
        if min(sides) <= 0:
            continue
        for row in range(max(0, low[i][1]), min(tile_height, high[i][1])):
            for column in range(max(0, low[i][0]), min(tile_width, high[i][0])):
                ids.append(((row * tile_width + column) << 32 | bits[i], i))
                counts[i] += 1
    ids.sort()  # of equal ones the first Gaussian first, as the stable sort there
    keys, owners = torch.tensor(ids, dtype=torch.int64).reshape(-1, 2).unbind(1)
    device = means2d.device
    return (
        torch.tensor([counts], dtype=torch.int32).to(device),
        keys.to(device),
        owners.int().to(device),
    )


@torch.no_grad()
def isect_offset_encode(
    isect_ids: Tensor, n_images: int, tile_width: int, tile_height: int
) -> Tensor:
    tiles = torch.arange(n_images * tile_height * tile_width, device=isect_ids.device)
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
    device, n = means2d.device, rows * columns
    starts = isect_offsets.flatten().long()
    ends = torch.cat([starts[1:], starts.new_tensor([len(flatten_ids)])])
    places = starts[:, None] + torch.arange(int((ends - starts).max()), device=device)
    real = (places < ends[:, None])[..., None]
    ids = flatten_ids[places.clamp(max=len(flatten_ids) - 1)].long()  # shorter lists: of any other
    tile, pixel = torch.arange(n, device=device), torch.arange(tile_size**2, device=device)
    corner = torch.stack([tile % columns, tile // columns], 1) * tile_size
    centres = torch.stack([pixel % tile_size, pixel // tile_size], 1) + 0.5
    spots = corner[:, None, None] + centres  # [tiles, 1, pixels, 2]
    dx, dy = (spots - means2d[0, ids][:, :, None]).unbind(-1)
    a, b, c = (t[..., None] for t in conics[0, ids].unbind(-1))
    sigma = 0.5 * (a * dx * dx + c * dy * dy) + b * dx * dy
    alpha = (opacities[0, ids][..., None] * (-sigma).exp()).clamp(max=ALPHA_MAX)
    alpha = torch.where(real & (sigma >= 0) & (alpha >= ALPHA_MIN), alpha, 0.0)
    after = (1 - alpha.detach()).cumprod(1)
    alpha = torch.where(after > LEAST_LIGHT, alpha, 0.0)
    light = torch.cat([alpha.new_ones(n, 1, tile_size**2), (1 - alpha).cumprod(1)], 1)
    shown = torch.einsum("tkp,tkc->tpc", alpha * light[:, :-1], colors[0, ids])
    shown = shown + light[:, -1, :, None] * backgrounds[0]

    def put_together(tiles: Tensor) -> Tensor:
        whole = tiles.reshape(rows, columns, tile_size, tile_size, -1).transpose(1, 2)
        whole = whole.reshape(rows * tile_size, columns * tile_size, -1)
        return whole[:image_height, :image_width][None]

    return put_together(shown), put_together(1 - light[:, -1])


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
