"""Common parts of losses at other cameras or on depth. Light to import.

Known depth of a photo, cameras without a photo, an image seen through another camera's depth, and
the loss between two renders.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from framework.plugin import StepContext

if TYPE_CHECKING:
    import numpy as np
    from torch import Tensor

    from framework.types import Camera, DepthMap, View

SEEN = 1e-6  # alpha from which a pixel shows something


def known_depth(ctx: StepContext, view: View) -> tuple[Tensor, Tensor] | None:
    """Return (depth [h, w], valid [h, w] bool) of a training view at the size of the training.

    A coarse pixel is the mean of its pixels, valid if all of them are known and within the photo's
    mask. None for a pseudo view.
    """
    if view.pseudo:
        return None
    size = view.camera.height, view.camera.width
    for photo, depth_map in zip(ctx.views, ctx.depth, strict=True):
        if photo.name == view.name:
            built = functools.partial(_known, photo, depth_map, size)
            valid: tuple[Tensor, Tensor] = ctx.once(
                f"framework/known_depth/{view.name}/{size}", built
            )
            return valid
    return None


def _known(photo: View, depth_map: DepthMap, size: tuple[int, int]) -> tuple[Tensor, Tensor]:
    valid = (depth_map.depth > 0) & (depth_map.confidence > 0)
    if photo.mask is not None:  # other depth may include what is masked
        valid &= photo.mask > 0.5
    factor = photo.camera.height // size[0]
    depth, share = (_boxes(t.float(), factor, size) for t in (depth_map.depth, valid))
    return depth, share > 0.999


def _boxes(values: Tensor, factor: int, size: tuple[int, int]) -> Tensor:
    """Means over factor x factor boxes of [H, W], cut to `size`."""
    if factor == 1:
        return values
    from torch.nn.functional import avg_pool2d

    return avg_pool2d(values[None, None], factor)[0, 0, : size[0], : size[1]]


def unseen_camera(ctx: StepContext, rng: np.random.Generator, size_of: Camera) -> Camera:
    """Return a camera between a training camera and its nearest other one, without a photo.

    Its orientation is interpolated too, its intrinsics are those of `size_of` (FSGS's text, section
    3.3; its code draws from a box around all). With a single training camera it is moved by up to a
    tenth of the extent.
    """
    import numpy as np
    import torch

    from framework import geometry

    cameras = [view.camera for view in ctx.views]
    first = cameras[int(rng.integers(len(cameras)))]
    share, shift = float(rng.random()), rng.standard_normal(3)
    if len(cameras) == 1:
        step = torch.from_numpy(0.1 * ctx.extent * np.clip(shift, -1, 1))
        camera = geometry.perturbed(first, torch.zeros(3, dtype=torch.float64), step)
        return replace(size_of, viewmat=camera.viewmat)
    return camera_between(cameras, first, share, size_of)


def camera_between(
    cameras: Sequence[Camera], first: Camera, share: float, size_of: Camera
) -> Camera:
    """Return the camera at `share` of the way from `first` to the nearest other one.

    Its orientation is interpolated too, its intrinsics are those of `size_of`.
    """
    import torch

    from framework import geometry
    from framework.compute.portable import product

    others = [camera for camera in cameras if camera is not first]
    other = min(others, key=lambda camera: math.dist(camera.center.tolist(), first.center.tolist()))
    a, b = (geometry.quaternions(camera.viewmat[:3, :3][None])[0] for camera in (first, other))
    b = b if float((a * b).sum()) >= 0 else -b
    rotation = geometry.rotation_matrices(((1 - share) * a + share * b)[None])[0]
    center = (1 - share) * first.center + share * other.center
    viewmat = torch.eye(4, dtype=torch.float64)
    viewmat[:3, :3], viewmat[:3, 3] = rotation, torch.from_numpy(-product(rotation, center))
    return replace(size_of, viewmat=viewmat)


def seen_through(
    image: Tensor, depth: Tensor, camera: Camera, source: Camera
) -> tuple[Tensor, Tensor, Tensor]:
    """Warp `source`'s image [C, H', W'] into `camera` by the depth [H, W] of `camera`, bilinearly.

    Differentiable in image and depth.

    Returns:
        [C, H, W]; valid [H, W] bool, in front of the source and within its image; depth [H, W] as
        the source measures it.
    """
    import torch

    from framework.compute.portable import inverse, product

    height, width = depth.shape
    x = torch.arange(width, dtype=torch.float64) + 0.5
    y = torch.arange(height, dtype=torch.float64)[:, None] + 0.5
    relative = product(source.viewmat, inverse(camera.viewmat))
    shift = product(source.K, relative[:3, 3]).tolist()
    turn = product(product(source.K, relative[:3, :3]), inverse(camera.K)).tolist()
    # a plane each of u z, v z, z: rows of the homography, computed once in float64
    u, v, z = (
        (row[0] * x + (row[1] * y + row[2])).float() * depth + by
        for row, by in zip(turn, shift, strict=True)
    )
    disparity = 1 / z.clamp(min=SEEN)
    u, v = u * disparity, v * disparity
    with torch.no_grad():
        inside = (u >= 0) & (u <= source.width) & (v >= 0) & (v <= source.height)
        valid = (z > SEEN) & inside & (depth > 0)
    return bilinear(image, u, v), valid, z


def bilinear(image: Tensor, u: Tensor, v: Tensor) -> Tensor:
    """[C, h, w]: `image` [C, H, W] at pixels u, v [h, w] (centre of the first at 0.5), its border
    repeated. Differentiable in all three. Products and sums one by one, whose bits are the same on
    any processor; those of PyTorch's grid_sample are not."""
    channels, height, width = image.shape
    u, v = (u - 0.5).clamp(0, width - 1), (v - 0.5).clamp(0, height - 1)
    left, top = (t.detach().nan_to_num().floor() for t in (u, v))  # no index is NaN, values are
    left, top = left.clamp(max=max(width - 2, 0)), top.clamp(max=max(height - 2, 0))
    right, down = u - left, v - top
    flat, first = image.reshape(channels, -1), (top * width + left).long().reshape(-1)

    def at(offset: int) -> Tensor:
        index = (first + offset).expand(channels, -1)
        return flat.gather(1, index).reshape(channels, *u.shape)

    to_right, to_down = int(width > 1), width * int(height > 1)
    near, far = at(0), at(to_down)
    upper = near + right * (at(to_right) - near)
    lower = far + right * (at(to_down + to_right) - far)
    return upper + down * (lower - upper)


def difference(first: Tensor, second: Tensor, ssim_weight: float) -> Tensor:
    """Photometric loss between two renders [3, H, W], (1 - w) L1 + w (1 - SSIM).

    It has a gradient in each render that has one. Each is computed as if the other were a photo,
    which gives the whole gradient, since the loss is symmetric.
    """
    from framework.kernels.losses import Target, photometric_loss

    total = first.new_zeros(())
    for one, other in ((first, second), (second, first)):
        if one.requires_grad:
            loss = photometric_loss(one, Target.of(other.detach()), ssim_weight)
            total = loss if not total.requires_grad else total + (loss - loss.detach())
    return total


def correlation(a: Tensor, b: Tensor) -> Tensor:
    """Pearson's correlation of two vectors [P]; 0 where one of them is constant."""
    from framework.compute.tensors import root

    a, b = a - a.mean(), b - b.mean()
    size = a.square().mean() * b.square().mean()
    mean: Tensor = (a * b).mean() / root(size.clamp(min=1e-24))
    return mean
