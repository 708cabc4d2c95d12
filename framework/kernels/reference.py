"""The rasterizer in plain torch: slow, readable, differentiable by autograd, exact in float64.

It is the definition that the kernels are tested against. The image formation is that of 3DGS
(Kerbl et al. 2023, section 4 and appendix A) with EWA projection (Zwicker et al. 2002):

    x_c = W x + t                    camera coordinates, OpenCV axes
    J   = [[fx/z, 0, -fx x/z^2], [0, fy/z, -fy y/z^2]]
    S'  = J W S W^T J^T + e I        pixels^2, S = R diag(exp(log_scales))^2 R^T
    a_i = min(0.99, o_i exp(-d^T S'^-1 d / 2)),  d = pixel centre - projected mean
    w_i = a_i prod_{j<i} (1 - a_j)   front to back by z, ties by index

e is the camera's dilation. A (pixel, Gaussian) pair takes part only if its unclamped alpha is at
least 1/255, and a pixel stops before the Gaussian that would bring its transmittance below 1e-4.
M counts the Gaussians that pass culling, P = H W the pixels, K the SH coefficients.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from framework.geometry import rotation_matrices
from framework.kernels.constants import (
    ALPHA_MAX,
    ALPHA_MIN,
    FRUSTUM_MARGIN,
    TRANSMITTANCE_MIN,
)
from framework.types import Camera, Gaussians, Render


@dataclass(frozen=True)
class Footprints:
    """The M Gaussians that pass culling, as the camera sees them, nearest first.

    index [M] into the stored Gaussians · means2d [M, 2] pixels · cov2d [M, 2, 2] pixels^2 ·
    depths [M] · opacities [M] activated, after the factors · colors [M, 3].
    """

    index: Tensor
    means2d: Tensor
    cov2d: Tensor
    depths: Tensor
    opacities: Tensor
    colors: Tensor

    def radii(self, width: int, height: int) -> Tensor:
        """[M] pixels: the larger half-side of the box outside which alpha < 1/255; 0 where that
        box holds no pixel centre of the image."""
        variances = self.cov2d.diagonal(dim1=1, dim2=2)
        sides = (2 * (self.opacities / ALPHA_MIN).log()[:, None] * variances).sqrt()
        end = sides.new_tensor([width - 1, height - 1])
        first = (self.means2d - sides - 0.5).ceil().clamp(min=0)
        last = (self.means2d + sides - 0.5).floor().minimum(end)
        return torch.where((first <= last).all(dim=1), sides.amax(dim=1), 0.0).detach()


def rasterize_reference(
    gaussians: Gaussians,
    camera: Camera,
    *,
    background: Tensor | None = None,
    sh_degree: int | None = None,
    opacity_factors: Tensor | None = None,
    means2d_offset: Tensor | None = None,
    near: float = 0.01,
) -> Render:
    """What `camera` sees of `gaussians`, in their dtype; memory and time are O(N H W).

    Args:
        background: [3], default black; not differentiated.
        sh_degree: the active degree, at most the stored one (default).
        opacity_factors: [N], multiply the activated opacities.
        means2d_offset: [N, 2], added to the projected means; a zero tensor here receives
            dLoss/dmeans2d in pixels.
        near: Gaussians whose mean has z < near are culled.

    Raises:
        ValueError: on a wrong shape.
    """
    n = len(gaussians)
    background = gaussians.means.new_zeros(3) if background is None else background
    _check_shape("background", background, (3,))
    seen = project(gaussians, camera, sh_degree, opacity_factors, means2d_offset, near)
    alphas = blend_alphas(seen, camera)
    transmittance = _transmittance(alphas)
    weights = alphas * transmittance[:-1]
    final = transmittance[-1]
    ground = background.detach().to(final)[:, None] * final
    shape = (camera.height, camera.width)
    radii = final.new_zeros(n).index_put((seen.index,), seen.radii(camera.width, camera.height))
    return Render(
        rgb=(seen.colors.T @ weights + ground).reshape(3, *shape),
        alpha=(1 - final).reshape(shape),
        depth=(seen.depths @ weights).reshape(shape),
        radii=radii.to(torch.float32),
    )


def project(
    gaussians: Gaussians,
    camera: Camera,
    sh_degree: int | None = None,
    opacity_factors: Tensor | None = None,
    means2d_offset: Tensor | None = None,
    near: float = 0.01,
) -> Footprints:
    """Cull, project and shade; arguments as in `rasterize_reference`."""
    n, means = len(gaussians), gaussians.means
    opacities = gaussians.opacities
    if opacity_factors is not None:
        _check_shape("opacity_factors", opacity_factors, (n,))
        opacities = opacities * opacity_factors
    if means2d_offset is not None:
        _check_shape("means2d_offset", means2d_offset, (n, 2))
    rotation, translation = (camera.viewmat[:3, i].to(means) for i in (slice(3), 3))
    points = means @ rotation.T + translation
    visible = inside(points.detach(), camera, near) & (opacities.detach() >= ALPHA_MIN)
    index = visible.nonzero()[:, 0]
    index = index[points.detach()[index, 2].argsort(stable=True)]
    points = points[index]
    means2d = _means2d(points, camera)
    if means2d_offset is not None:
        means2d = means2d + means2d_offset[index]
    factors = _covariance_factor(gaussians)[index]
    half = _perspective_jacobian(points, camera) @ rotation @ factors
    cov2d = half @ half.mT + camera.dilation * torch.eye(2).to(means)
    colors = shade(gaussians, camera.center.to(means), sh_degree)[index]
    return Footprints(index, means2d, cov2d, points[:, 2], opacities[index], colors)


def blend_alphas(seen: Footprints, camera: Camera) -> Tensor:
    """[M, P] alpha of every pair that is blended, 0 for all others."""
    raw = _raw_alphas(seen, camera)
    alphas = torch.where(raw >= ALPHA_MIN, raw.clamp(max=ALPHA_MAX), 0.0)
    # Transmittance only falls, so a pixel that has stopped stays below the threshold.
    alive = _transmittance(alphas.detach())[1:] >= TRANSMITTANCE_MIN
    return torch.where(alive, alphas, 0.0)


def cutoff_margin(seen: Footprints, camera: Camera) -> Tensor:
    """[H, W] relative distance of a pixel's blending to its nearest discontinuity.

    The smallest |ln(value / threshold)| over the Gaussians, of the unclamped alpha against 1/255
    (a jump) and against 0.99 (a kink) and of the transmittance against 1e-4 (a jump). Two
    implementations may differ by rounding times 1/margin; tests leave out pixels below a margin.
    """
    raw = _raw_alphas(seen, camera)
    alphas = torch.where(raw >= ALPHA_MIN, raw.clamp(max=ALPHA_MAX), 0.0)
    transmittance = _transmittance(alphas)[1:]
    edges = ((raw, ALPHA_MIN), (raw, ALPHA_MAX), (transmittance, TRANSMITTANCE_MIN))
    distances = [(value.log() - math.log(edge)).abs() for value, edge in edges]
    far = torch.full((1, raw.shape[1]), math.inf, dtype=raw.dtype)
    return torch.cat([*distances, far]).amin(0).reshape(camera.height, camera.width).detach()


def shade(gaussians: Gaussians, center: Tensor, sh_degree: int | None = None) -> Tensor:
    """[N, 3] colours max(0, 0.5 + SH(d)), d the unit direction from the camera `center` [3]."""
    degree = gaussians.active_degree(sh_degree)
    directions = torch.nn.functional.normalize(gaussians.means - center, dim=1)
    without = gaussians.shN.new_zeros(len(gaussians) - len(gaussians.shN), *gaussians.shN.shape[1:])
    bands = torch.cat([gaussians.shN, without])
    coefficients = torch.cat([gaussians.sh0, bands], dim=1)[:, : (degree + 1) ** 2]
    basis = sh_basis(directions, degree)
    return (0.5 + torch.einsum("nk,nkc->nc", basis, coefficients)).clamp(min=0)


def sh_basis(directions: Tensor, degree: int) -> Tensor:
    """[N, (degree+1)^2] real spherical harmonics at unit `directions` [N, 3].

    Condon-Shortley phase, ordered by (l, m), as 3DGS stores them: the normalisations are
    sqrt((2l+1)/(4 pi) (l-|m|)!/(l+|m|)!), times sqrt(2) for m != 0 (Sloan 2008, appendix A2).
    """
    x, y, z = directions.unbind(dim=1)
    xx, yy, zz = x * x, y * y, z * z
    c = [math.sqrt(k / math.pi) for k in (1 / 4, 3 / 4, 15 / 4, 5 / 16, 15 / 16)]
    d = [math.sqrt(k / math.pi) for k in (35 / 32, 105 / 4, 21 / 32, 7 / 16, 105 / 16)]
    rows = [
        [c[0] * torch.ones_like(x)],
        [-c[1] * y, c[1] * z, -c[1] * x],
        [
            c[2] * x * y,
            -c[2] * y * z,
            c[3] * (2 * zz - xx - yy),
            -c[2] * x * z,
            c[4] * (xx - yy),
        ],
        [
            -d[0] * y * (3 * xx - yy),
            d[1] * x * y * z,
            -d[2] * y * (4 * zz - xx - yy),
            d[3] * z * (2 * zz - 3 * xx - 3 * yy),
            -d[2] * x * (4 * zz - xx - yy),
            d[4] * z * (xx - yy),
            -d[0] * x * (xx - 3 * yy),
        ],
    ]
    return torch.stack([term for row in rows[: degree + 1] for term in row], dim=1)


def _check_shape(name: str, tensor: Tensor, shape: tuple[int, ...]) -> None:
    if tuple(tensor.shape) != shape:
        raise ValueError(f"rasterize: {name} must have shape {shape}, got {tuple(tensor.shape)}")


def _means2d(points: Tensor, camera: Camera) -> Tensor:
    """[N, 2] pixels: perspective projection of camera-space `points` [N, 3]."""
    focal = camera.K.diagonal()[:2].to(points)
    principal = camera.K[:2, 2].to(points)
    return focal * points[:, :2] / points[:, 2:] + principal


def inside(points: Tensor, camera: Camera, near: float) -> Tensor:
    """[N] bool: in front of the near plane, mean within 0.75 image sizes of the image centre."""
    size = points.new_tensor([camera.width, camera.height])
    reach = (_means2d(points, camera) - size / 2).abs() <= (0.5 + FRUSTUM_MARGIN) * size
    return (points[:, 2] >= near) & reach.all(dim=1)


def _perspective_jacobian(points: Tensor, camera: Camera) -> Tensor:
    """[M, 2, 3] pixels per scene unit: d means2d / d points."""
    fx, fy = camera.K.diagonal()[:2].tolist()
    x, y, z = points.unbind(dim=1)
    zero = torch.zeros_like(z)
    rows = (fx / z, zero, -fx * x / z**2, zero, fy / z, -fy * y / z**2)
    return torch.stack(rows, dim=1).reshape(-1, 2, 3)


def _covariance_factor(gaussians: Gaussians) -> Tensor:
    """[M, 3, 3] R diag(scales), whose product with its transpose is the covariance."""
    return rotation_matrices(gaussians.quats) * gaussians.scales[:, None, :]


def _raw_alphas(seen: Footprints, camera: Camera) -> Tensor:
    """[M, P] opacity times the Gaussian falloff at every pixel centre, unclamped."""
    ys = torch.arange(camera.height, device=seen.index.device).to(seen.means2d) + 0.5
    xs = torch.arange(camera.width, device=seen.index.device).to(seen.means2d) + 0.5
    pixels = torch.cartesian_prod(ys, xs).flip(1)
    offsets = pixels - seen.means2d[:, None, :]
    squared = torch.einsum("mpi,mij,mpj->mp", offsets, torch.linalg.inv(seen.cov2d), offsets)
    return seen.opacities[:, None] * (-0.5 * squared).exp()


def _transmittance(alphas: Tensor) -> Tensor:
    """[M + 1, P] light left before each Gaussian, and after the last."""
    ones = alphas.new_ones(1, alphas.shape[1])
    return torch.cat([ones, (1 - alphas).cumprod(dim=0)])
