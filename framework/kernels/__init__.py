"""The rasterizer: Gaussians and a camera to a render, and the gradient of a loss on it.

`rasterize` runs the numba kernels (float32) as one differentiable call;
`reference.rasterize_reference` is its readable torch twin in any dtype. `render_gradient` computes
the same gradient without autograd, as training does. Results and gradients have the same bits on
any number of threads.
"""

import functools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from framework.errors import UserError
from framework.kernels.lending import Lender
from framework.kernels.pipeline import Arrays, Image, Workspace
from framework.types import Camera, Gaussians, Render

_NOTHING, _BLACK = np.empty((0, 0), np.float32), np.zeros(3, np.float32)
_free: list[Workspace] = []  # workspaces not in use; two renders may be waiting for gradients


def borrow() -> Workspace:
    """Take an unused workspace; `give_back` it once its content is no longer needed."""
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


def _render(
    work: Workspace,
    tensors: Sequence[Tensor],
    camera: Camera,
    background: np.ndarray,
    degree: int,
    near: float,
    *,
    with_depth: bool,
    kept: bool,
) -> tuple[Image, np.ndarray]:
    """The image and radii [N]. kept: for a gradient, hence in memory that is lent again; others may
    hold on to what they render."""
    size, n = (camera.height, camera.width), len(tensors[0])
    of_images, of_radii = (work.images, work.radii) if kept else (Lender(), Lender())
    planes, depth = of_images.lend([(4, *size), size if with_depth else (0, 0)])
    (radii,) = of_radii.lend([(n,)])
    image = Image(planes[:3], planes[3], depth)
    work.render(Arrays(*map(_numpy, tensors)), camera, background, degree, near, image, radii)
    return image, radii


def _pull_back(work: Workspace, shapes: Sequence[tuple[int, ...]]) -> list[Tensor]:
    """From the gradient on the screen to that in the tensors, of these shapes, that made it."""
    arrays = [*work.gradients.lend(shapes[:-1]), *work.pulls.lend(shapes[-1:])]
    work.project_backward(Arrays(*arrays))
    return [torch.from_numpy(array) for array in arrays]


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
        work, kept = borrow(), any(ctx.needs_input_grad)
        seen = camera, background, degree, near
        image, radii = _render(work, tensors, *seen, with_depth=with_depth, kept=kept)
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
        gradients = _pull_back(work, ctx.shapes)
        give_back(work)
        return (*gradients, None, None, None, None, None)


def _backward_images(image: Image, grads: tuple[Tensor | None, ...]) -> tuple[Image, Image]:
    """The render and the gradient in it, as the kernel reads them: with alpha and depth, or with
    neither for a loss of the colours alone."""

    def gradient(gradients: Tensor | None, like: np.ndarray) -> np.ndarray:
        return np.zeros_like(like) if gradients is None else _numpy(gradients)

    rgb, alpha, depth = image.rgb, image.alpha, image.depth
    g_rgb, g_alpha, g_depth = grads[:3]
    if g_alpha is None and g_depth is None:
        return image, Image(gradient(g_rgb, rgb), _NOTHING, _NOTHING)
    whole = depth if depth.size else np.zeros_like(alpha)
    gradients = Image(gradient(g_rgb, rgb), gradient(g_alpha, alpha), gradient(g_depth, alpha))
    return Image(rgb, alpha, whole), gradients


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

    It is differentiable in all tensors except the background.

    Args:
        gaussians: the N Gaussians.
        camera: the view.
        background: [3], default black.
        sh_degree: active degree, at most the stored one (default).
        opacity_factors: [N], multiply the activated opacities.
        means2d_offset: [N, 2], added to the projected means. Pass zeros that require a gradient to
            get d loss / d means2d in pixels.
        near: Gaussians with a smaller z are culled.
        depth: False omits the depth, which is [0, 0] then. This saves a tenth of the blending.

    Raises:
        UserError: for wrong shapes and for dtypes other than float32.
    """
    tensors = _tensors(gaussians, opacity_factors, means2d_offset)
    degree, colour = gaussians.active_degree(sh_degree), _colour(background)
    return Render(*_Rasterize.apply(*tensors, camera, colour, degree, float(near), depth))


class ScreenGradient:
    """The gradient of a loss on one render with respect to the projected Gaussians.

    `pull_back` or `framework.train.optim.Adam.step_from` takes it to the parameters. Either can be
    called once, because it releases the render's workspace.

    Attributes:
        gaussians: the rendered ones.
        radii: [N] pixels, 0 = culled.
        absolute: [N, 2], see `render_gradient`; None unless requested.
    """

    def __init__(
        self,
        work: Workspace,
        gaussians: Gaussians,
        radii: np.ndarray,
        absolute: np.ndarray | None = None,
    ) -> None:
        self._work: Workspace | None = work
        self.gaussians, self.radii = gaussians, torch.from_numpy(radii)
        self.absolute = None if absolute is None else torch.from_numpy(absolute)

    def pull_back(self) -> tuple[dict[str, Tensor], Tensor]:
        """Compute the gradient with respect to the parameters.

        Returns:
            The gradient in every tensor of `gaussians` by name, and in the projected means [N, 2]
            in pixels.

        Raises:
            RuntimeError: if the gradient was already used.
        """
        work, tensors = self.take(), dict(self.gaussians.items())
        n = len(self.gaussians)
        shapes = [*(tuple(t.shape) for t in tensors.values()), (n,), (n, 2)]
        *gradients, _, means2d = _pull_back(work, shapes)
        give_back(work)
        return dict(zip(tensors, gradients, strict=True)), means2d

    def drop(self) -> None:
        """Give the workspace back without computing the gradient."""
        give_back(self.take())

    def take(self) -> Workspace:
        """Return the render's workspace, which the caller gives back.

        Raises:
            RuntimeError: if the gradient was already used.
        """
        if self._work is None:
            raise RuntimeError("render_gradient: this gradient was already used")
        work, self._work = self._work, None
        return work


def render_gradient(
    gaussians: Gaussians,
    camera: Camera,
    image_gradient: Callable[[np.ndarray], np.ndarray],
    *,
    background: Tensor | None = None,
    sh_degree: int | None = None,
    opacity_factors: Tensor | None = None,
    near: float = 0.01,
    absolute: bool = False,
    depth_gradient: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]] | None = None,
) -> ScreenGradient:
    """Render as `rasterize` does and compute the gradient of a loss of the colours.

    The bits are those of autograd, in less time.

    Args:
        gaussians: the N Gaussians.
        camera: the view.
        image_gradient: given the render's rgb [3, H, W] float32, returns the gradient of the loss
            in it.
        background, sh_degree, opacity_factors, near: as in `rasterize`.
        absolute: also sum the absolute gradient in the projected means over the pixels, in one more
            pass. Gradients that cancel still count (AbsGS, Ye et al. 2024).
        depth_gradient: given alpha and depth [H, W] float32, returns the gradients in them to add.

    Raises:
        UserError: as `rasterize`, and for a gradient of another shape or dtype.
    """
    how = background, sh_degree, near, opacity_factors
    work, image, radii = rendered(gaussians, camera, *how, with_depth=depth_gradient is not None)
    in_rgb = image_gradient(image.rgb)
    if in_rgb.shape != image.rgb.shape or in_rgb.dtype != np.float32:
        raise UserError(
            f"render_gradient: expected a float32 gradient of shape {list(image.rgb.shape)}, got"
            f" {in_rgb.dtype} {list(in_rgb.shape)}"
        )
    pulls = work.blend_absolute(image, in_rgb) if absolute else None
    elsewhere = _NOTHING, _NOTHING
    if depth_gradient is not None:
        elsewhere = depth_gradient(image.alpha, image.depth)
    work.blend_backward(image, Image(in_rgb, *elsewhere))
    return ScreenGradient(work, gaussians, radii, pulls)


def rendered(
    gaussians: Gaussians,
    camera: Camera,
    background: Tensor | None,
    sh_degree: int | None,
    near: float,
    opacity_factors: Tensor | None = None,
    *,
    with_depth: bool = False,
) -> tuple[Workspace, Image, np.ndarray]:
    """Render as `rasterize` does and keep what a gradient needs.

    Returns:
        The workspace, which the caller gives back; the image; radii [N] in pixels.

    Raises:
        UserError: as `rasterize`.
    """
    tensors = _tensors(gaussians, opacity_factors, None)
    seen = camera, _colour(background), gaussians.active_degree(sh_degree), near
    work = borrow()
    return work, *_render(work, tensors, *seen, with_depth=with_depth, kept=True)


def _colour(background: Tensor | None) -> np.ndarray:
    """The background [3], by default black."""
    if background is None:
        return _BLACK
    if tuple(background.shape) != (3,):
        raise UserError(
            f"rasterize: expected background of shape [3], got {list(background.shape)}"
        )
    return _numpy(background)


@functools.lru_cache(maxsize=4)
def _filled(value: float, *shape: int) -> Tensor:
    """Read only: the same for all renders of as many Gaussians."""
    return torch.full(shape, value)


def _tensors(
    gaussians: Gaussians, factors: Tensor | None, offset: Tensor | None
) -> tuple[Tensor, ...]:
    """What is rendered, in the order of `Arrays`; shapes fit, as kernels do not check bounds."""
    n = len(gaussians)
    factors = _filled(1.0, n) if factors is None else factors
    offset = _filled(0.0, n, 2) if offset is None else offset
    expected = {"means": (n, 3), "quats": (n, 4), "log_scales": (n, 3), "opacity_logits": (n,)}
    banded = min(n, gaussians.shN.shape[0])
    expected |= {"sh0": (n, 1, 3), "shN": (banded, gaussians.shN.shape[1], 3)}
    tensors = dict(gaussians.items())
    for name, tensor in tensors.items():
        _check_shape(name, tensor, expected[name], n)
    _check_shape("opacity_factors", factors, (n,), n)
    _check_shape("means2d_offset", offset, (n, 2), n)
    return (*tensors.values(), factors, offset)


def _check_shape(name: str, tensor: Tensor, shape: tuple[int, ...], n: int) -> None:
    if tuple(tensor.shape) != shape:
        raise UserError(
            f"rasterize: expected {name} of shape {list(shape)} for {n} Gaussians, got"
            f" {list(tensor.shape)}"
        )
