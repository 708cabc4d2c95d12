"""Random Gaussians before a random camera, for comparing rasterizers.

All numbers are exactly representable in float32, also the camera's, so that a float64 and a float32
implementation get the same scene and differ by their arithmetic alone.
"""

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from framework.compute.rng import stream
from framework.types import Camera, Gaussians

SIZES = ((40, 30), (33, 47), (48, 32), (16, 16), (65, 19), (21, 50), (7, 5))


@dataclass(frozen=True)
class Case:
    """One call of a rasterizer. factors [N], offset [N, 2] (zeros), background [3]; float32."""

    gaussians: Gaussians
    camera: Camera
    background: Tensor
    factors: Tensor
    offset: Tensor
    sh_degree: int


def random_case(
    seed: int,
    n: int = 80,
    spread: float = 0.6,
    margin: float = 0.3,
    size: tuple[int, int] | None = None,
    footprint: float = 2.5,
) -> Case:
    """Scene number `seed`: fx != fy, principal point off the centre, SH degree seed % 4.

    spread: log-normal sigma of the footprint sizes, around `footprint` [px]. margin: means lie up
    to this share of the image size outside it; one in ten is beyond the frustum or behind the
    camera. size: (width, height); without, one of SIZES.
    """
    rng = stream(seed, "test-scene")
    width, height = size or SIZES[seed % len(SIZES)]
    camera = random_camera(rng, width, height)
    if seed % 3 == 2:  # as of a smaller image
        camera = replace(camera, dilation=0.125)
    pixels = rng.uniform(-margin, 1 + margin, (n, 2)) * [width, height]
    z = rng.uniform(1.5, 6.0, n)
    z[rng.random(n) < 0.05] *= -1
    pixels[rng.random(n) < 0.05] *= 4
    focal, principal = (camera.K.numpy()[[0, 1], i] for i in ([0, 1], 2))
    points = np.column_stack([(pixels - principal) / focal * z[:, None], z])
    viewmat = camera.viewmat.numpy()
    means = (points - viewmat[:3, 3]) @ viewmat[:3, :3]
    sigma_px = footprint * np.exp(spread * rng.standard_normal((n, 3)))
    degree = seed % 4
    gaussians = Gaussians(
        means=_tensor(means),
        quats=_tensor(rng.standard_normal((n, 4)) * rng.uniform(0.5, 2.0, (n, 1))),
        log_scales=_tensor(np.log(sigma_px * np.abs(z)[:, None] / focal.mean())),
        opacity_logits=_tensor(rng.normal(0.0, 2.0, n)),
        sh0=_tensor(rng.normal(0.0, 1.0, (n, 1, 3))),
        shN=_tensor(rng.normal(0.0, 0.3, (n, (degree + 1) ** 2 - 1, 3))),
    )
    factors = rng.uniform(0.3, 1.0, n) * (rng.random(n) < 0.9)
    background = rng.random(3)
    return Case(gaussians, camera, _tensor(background), _tensor(factors), torch.zeros(n, 2), degree)


def crowded_case(seed: int) -> Case:
    """500 mostly opaque Gaussians of very different sizes: pixels stop early; factors 0 or 1."""
    case = random_case(seed, n=500, spread=0.9)
    opaque = case.gaussians.replace(opacity_logits=case.gaussians.opacity_logits + 2.0)
    return replace(case, gaussians=opaque, factors=(case.factors > 0).float())


def wide_case(seed: int) -> Case:
    """An image of 21 columns of tiles: more than there are strips, which large ones span."""
    return random_case(seed, n=150, spread=1.2, size=(330, 24), footprint=8.0)


def random_camera(rng: np.random.Generator, width: int, height: int) -> Camera:
    """A camera with a random pose near the origin; its numbers are float32."""
    rotation = rotation_matrix(rng.standard_normal(4))
    viewmat = np.eye(4)
    viewmat[:3, :3], viewmat[:3, 3] = rotation, rng.uniform(-1, 1, 3)
    fx, fy = rng.uniform(0.8, 1.6, 2) * width
    cx, cy = np.array([width, height]) * rng.uniform(0.35, 0.65, 2)
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    return Camera(_tensor(viewmat), _tensor(K), width, height)


def rotation_matrix(quat: np.ndarray) -> np.ndarray:
    """[3, 3] rotation of a wxyz quaternion, which need not be normalised."""
    w, x, y, z = quat / np.linalg.norm(quat)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _tensor(array: np.ndarray) -> Tensor:
    return torch.from_numpy(np.ascontiguousarray(array)).to(torch.float32)
