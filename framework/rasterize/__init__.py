"""One differentiable call: Gaussians and a camera -> a render.

`rasterize` runs the numba kernels (float32); `reference.rasterize_reference` is its readable torch
twin (any dtype). Results and gradients have the same bits on any number of threads.
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from framework.errors import UserError
from framework.rasterize.lending import Lender
from framework.rasterize.pipeline import Arrays, Image, Workspace
from framework.types import Camera, Gaussians, Render

__all__ = ["Arrays", "Image", "Workspace", "borrow", "give_back", "rasterize"]

_free: list[Workspace] = []  # workspaces not in use; two renders may be waiting for gradients


def borrow() -> Workspace:
    """A workspace nobody else uses; `give_back` it when nothing of it is needed any more."""
    try:
        return _free.pop()
    except IndexError:  # asking first would leave another thread the time to take the last one
        return Workspace()


def give_back(work: Workspace) -> None:
    """Return a workspace for the next render."""
    _free.append(work)


def _numpy(tensor: Tensor) -> np.ndarray:
    """A contiguous float32 view; anything else would compile another, wider kernel."""
    if tensor.dtype != torch.float32:
        raise UserError(f"rasterize: expected float32 tensors, got {tensor.dtype}")
    return tensor.detach().contiguous().numpy()


class _Rasterize(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        means: Tensor,
        quats: Tensor,
        log_scales: Tensor,
        opacity_logits: Tensor,
        sh0: Tensor,
        shN: Tensor,
        factors: Tensor,
        offset: Tensor,
        camera: Camera,
        background: np.ndarray,
        degree: int,
        near: float,
        with_depth: bool,
    ) -> Any:
        ctx.set_materialize_grads(False)
        tensors = (means, quats, log_scales, opacity_logits, sh0, shN, factors, offset)
        work = borrow()
        size, n = (camera.height, camera.width), len(means)
        kept = any(ctx.needs_input_grad)  # in a step; others may hold on to what they render
        of_images, of_radii = (work.images, work.radii) if kept else (Lender(), Lender())
        planes, depth = of_images.lend([(4, *size), size if with_depth else (0, 0)])
        (radii,) = of_radii.lend([(n,)])
        arrays = Arrays(*(_numpy(t) for t in tensors))
        work.project(arrays, camera, degree, near, radii)
        work.sort()
        work.bin()
        image = Image(planes[:3], planes[3], depth)
        work.blend(background, image)
        outputs = tuple(map(torch.from_numpy, (image.rgb, image.alpha, image.depth, radii)))
        ctx.mark_non_differentiable(outputs[-1])
        if kept:
            ctx.work = work
            ctx.save_for_backward(*outputs[:3])  # as attributes they would hold ctx, and it them
            ctx.shapes = [t.shape for t in tensors]
        else:
            give_back(work)
        return outputs

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor) -> Any:
        work = ctx.work
        if work is None:
            raise RuntimeError("rasterize: this render's gradient was already taken")
        image = Image(*map(_numpy, ctx.saved_tensors))
        ctx.work = None
        work.blend_backward(*_backward_images(image, grads))
        gradients = [*work.gradients.lend(ctx.shapes[:-1]), *work.pulls.lend(ctx.shapes[-1:])]
        work.project_backward(Arrays(*gradients))
        give_back(work)
        return (*map(torch.from_numpy, gradients), None, None, None, None, None)


def _backward_images(image: Image, grads: tuple[Tensor | None, ...]) -> tuple[Image, Image]:
    """The render and the gradient in it, as the kernel reads them: with alpha and depth, or with
    neither for a loss of the colours alone."""

    def gradient(given: Tensor | None, like: np.ndarray) -> np.ndarray:
        return np.zeros_like(like) if given is None else _numpy(given)

    rgb, alpha, depth = image.rgb, image.alpha, image.depth
    g_rgb, g_alpha, g_depth = grads[:3]
    if g_alpha is None and g_depth is None:
        nothing = np.empty((0, 0), np.float32)
        return image, Image(gradient(g_rgb, rgb), nothing, nothing)
    whole = depth if depth.size else np.zeros_like(alpha)
    given = Image(gradient(g_rgb, rgb), gradient(g_alpha, alpha), gradient(g_depth, alpha))
    return Image(rgb, alpha, whole), given


def rasterize(
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
    """Render N Gaussians (3DGS: EWA projection, alpha blending front to back).

    background: [3], default black. sh_degree: the active degree, at most the stored one (default).
    opacity_factors: [N], multiply the activated opacities. means2d_offset: [N, 2], added to the
    projected means; pass zeros that require a gradient to get d loss / d means2d in pixels.
    near: Gaussians with a smaller z are culled. depth: False leaves the depth out ([0, 0] then),
    which saves a tenth of the blending. Differentiable in all tensors but the background.
    Raises UserError for other dtypes than float32 and for wrong shapes.
    """
    n = len(gaussians)
    degree = gaussians.sh_degree if sh_degree is None else min(sh_degree, gaussians.sh_degree)
    factors = _filled(1.0, n) if opacity_factors is None else opacity_factors
    offset = _filled(0.0, n, 2) if means2d_offset is None else means2d_offset
    colour = torch.zeros(3) if background is None else background
    tensors = (*(tensor for _, tensor in gaussians.items()), factors, offset)
    _check_shapes(n, gaussians, factors, offset, colour)
    outputs = _Rasterize.apply(*tensors, camera, _numpy(colour), degree, float(near), depth)
    return Render(*outputs)


@functools.lru_cache(maxsize=4)
def _filled(value: float, *shape: int) -> Tensor:
    """Read only: the same for all renders of as many Gaussians."""
    return torch.full(shape, value)


def _check_shapes(
    n: int, gaussians: Gaussians, factors: Tensor, offset: Tensor, colour: Tensor
) -> None:
    """The kernels do not check bounds."""
    expected = {"means": (n, 3), "quats": (n, 4), "log_scales": (n, 3), "opacity_logits": (n,)}
    banded = min(n, gaussians.shN.shape[0])
    expected |= {"sh0": (n, 1, 3), "shN": (banded, gaussians.shN.shape[1], 3)}
    given = [(name, tensor, expected[name]) for name, tensor in gaussians.items()]
    given += [("opacity_factors", factors, (n,)), ("means2d_offset", offset, (n, 2))]
    for name, tensor, shape in [*given, ("background", colour, (3,))]:
        if tuple(tensor.shape) != shape:
            raise UserError(
                f"rasterize: expected {name} of shape {list(shape)} for {n} Gaussians, got"
                f" {list(tensor.shape)}"
            )
