"""`rasterizer=gsplat`: CUDA kernels of the package gsplat; the training is on the GPU, whose sums
have no fixed order, so the same seed does not give the same bits.

gsplat (Ye et al. 2024, "gsplat: An open-source library for Gaussian splatting") has the same image
formation but for two constants in its kernels: its alphas end at 0.999, ours at 0.99, and of
Gaussians beyond 0.65 image sizes from the middle it bounds the slope of the perspective.
"""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any, ClassVar

from framework.backends.autograd import ByAutograd
from framework.errors import UserError, require

if TYPE_CHECKING:
    from torch import Tensor

    from framework.types import Camera, Gaussians, Render

VERSION = "1.5.3"  # whose functions and constants are relied on
INSTALL = f"pip install 'fishersplat[gsplat]', which brings {VERSION}, or use rasterizer=numba"


@dataclass(frozen=True)
class Gsplat(ByAutograd):
    """The functions of gsplat, one after the other, as its own `rasterization` calls them."""

    name: ClassVar[str] = "gsplat"
    keeps_bits: ClassVar[bool] = False

    @property
    def device(self) -> str:
        return "cuda"

    def ready(self) -> None:
        import torch

        require(
            torch.cuda.is_available(),
            f"rasterizer=gsplat: expected a CUDA device, got none that torch {torch.__version__}"
            " can use; run it where there is one, or use rasterizer=numba",
        )
        installed = _installed()
        require(
            installed == VERSION,
            f"rasterizer=gsplat: expected the package gsplat {VERSION}, got"
            f" {installed or 'none'}; {INSTALL}",
        )
        require(
            _compiled(),
            "rasterizer=gsplat: expected gsplat's CUDA kernels, got none: it compiles them at its"
            " first use with nvcc of the CUDA toolkit, which is missing; install that, or use"
            " rasterizer=numba",
        )
        torch.backends.cudnn.allow_tf32 = False  # SSIM's windows have float32's 24 bits, not 11

    def facts(self) -> dict[str, Any]:
        import torch

        return {
            **super().facts(),
            "gsplat": _installed(),
            "cuda": torch.version.cuda,
            "gpu": torch.cuda.get_device_name(),
        }

    def render(
        self,
        gaussians: Gaussians,
        camera: Camera,
        *,
        background: Tensor | None = None,
        sh_degree: int | None = None,
        opacity_factors: Tensor | None = None,
        means2d_offset: Tensor | None = None,
        near: float = 0.01,
        depth: bool = True,
    ) -> Render:
        import gsplat
        import torch

        from framework.kernels.constants import TILE
        from framework.types import Render

        g, size = gaussians.to(self.device), (camera.width, camera.height)
        opacities = _opacities(g, camera, opacity_factors, near)
        viewmats, Ks = (m.to(g.means)[None] for m in (camera.viewmat, camera.K))
        boxes, means2d, depths, conics, _ = gsplat.fully_fused_projection(
            g.means,
            None,
            g.quats,
            g.scales,
            viewmats,
            Ks,
            *size,
            eps2d=camera.dilation,
            near_plane=near,
            opacities=opacities.detach(),
        )
        if means2d_offset is not None:
            means2d = means2d + means2d_offset.to(means2d)[None]
        tiles = [-(-side // TILE) for side in size]
        _, ids, order = gsplat.isect_tiles(means2d, boxes, depths, TILE, *tiles)
        offsets = gsplat.isect_offset_encode(ids, 1, *tiles)
        seen = (boxes > 0).all(dim=-1)  # of the others gsplat leaves everything undefined
        channels = _colours(g, camera, sh_degree, seen[0])[None]
        ground = g.means.new_zeros(3) if background is None else background.detach().to(g.means)
        if depth:
            channels = torch.cat([channels, torch.where(seen, depths, 0.0)[..., None]], -1)
            ground = torch.cat([ground, ground.new_zeros(1)])
        image, alpha = gsplat.rasterize_to_pixels(
            means2d, conics, channels, opacities[None], *size, TILE, offsets, order, ground[None]
        )
        planes = image[0].permute(2, 0, 1).contiguous()
        return Render(
            rgb=planes[:3],
            alpha=alpha[0, :, :, 0],
            depth=planes[3] if depth else planes.new_zeros(0, 0),
            radii=_radii(seen[0], means2d[0], conics[0], opacities, camera),
        )


def _installed() -> str | None:
    """The version of gsplat, None without it."""
    try:
        return version("gsplat") if importlib.util.find_spec("gsplat") else None
    except PackageNotFoundError:
        return None


def _compiled() -> bool:
    """Whether gsplat has its kernels; compiles them the first time, which takes minutes."""
    from gsplat.cuda import _backend

    return _backend._C is not None


def _opacities(g: Gaussians, camera: Camera, factors: Tensor | None, near: float) -> Tensor:
    """[N] activated, after the factors; 0 for Gaussians that we cull and gsplat would not."""
    import torch

    from framework.kernels.reference import inside

    opacities = g.opacities
    if factors is not None:
        if tuple(factors.shape) != (len(g),):
            raise UserError(
                f"rasterize: expected opacity_factors of shape [{len(g)}], got"
                f" {list(factors.shape)}"
            )
        opacities = opacities * factors.to(opacities)
    pose = camera.viewmat.to(g.means)
    points = g.means.detach() @ pose[:3, :3].T + pose[:3, 3]
    return torch.where(inside(points, camera, near), opacities, 0.0)


def _colours(g: Gaussians, camera: Camera, sh_degree: int | None, seen: Tensor) -> Tensor:
    """[N, 3] of the Gaussians `seen` [N] from the camera."""
    import gsplat
    import torch

    degree = g.active_degree(sh_degree)
    missing = g.shN.new_zeros(len(g) - len(g.shN), *g.shN.shape[1:])
    coefficients = torch.cat([g.sh0, torch.cat([g.shN, missing])], 1)
    directions = g.means - camera.center.to(g.means)
    colours = gsplat.spherical_harmonics(degree, directions, coefficients, masks=seen)
    return torch.where(seen[:, None], (colours + 0.5).clamp(min=0), 0.0)


def _radii(
    seen: Tensor, means2d: Tensor, conics: Tensor, opacities: Tensor, camera: Camera
) -> Tensor:
    """[N] as `framework.types.Render` has them; gsplat's own are rounded up."""
    import torch

    from framework.kernels.reference import Footprints

    with torch.no_grad():
        a, b, c = torch.where(seen[:, None], conics, 1.0).unbind(1)
        b = torch.where(seen, b, 0.0)
        inverse = 1 / (a * c - b * b)
        cov2d = torch.stack([torch.stack([c, -b], 1), torch.stack([-b, a], 1)], 1)
        cov2d = cov2d * inverse[:, None, None]
        index = torch.arange(len(seen), device=seen.device)
        footprints = Footprints(index, means2d, cov2d, a, opacities.clamp(min=1 / 255), cov2d)
        return torch.where(seen, footprints.radii(camera.width, camera.height), 0.0)
