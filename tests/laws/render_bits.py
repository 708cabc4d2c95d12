"""SHA-256 of what steps compute and of Fisher information; `python -m tests.laws.render_bits N` has
that of steps."""

import hashlib
import sys
from dataclasses import replace

import torch
from torch import Tensor

from framework.compute.parallel import set_threads
from framework.fisher.information import fisher_information
from framework.kernels import rasterize
from framework.kernels.losses import Target, photometric_loss
from framework.types import Camera, Gaussians
from tests.numerics.scenes import Case, random_case, wide_case


def render_bits(threads: int, fisher: bool = True) -> str:
    """Digest of what a training step computes with `threads` kernel threads; fisher: and Fisher
    information, whose kernels take long to compile."""
    set_threads(threads)
    try:
        cases = _large(random_case(3, n=600)), wide_case(201)
        tensors = [tensor for case in cases for tensor in _step(case, fisher)]
    finally:
        set_threads(0)
    sha = hashlib.sha256()
    for tensor in tensors:
        sha.update(tensor.detach().contiguous().numpy().tobytes())
    return sha.hexdigest()


def _large(case: Case) -> Case:
    small = case.camera
    camera = Camera(small.viewmat, small.K * 1.0, small.width * 3, small.height * 3)
    return replace(case, camera=camera)


def _step(case: Case, fisher: bool) -> list[Tensor]:
    gaussians = case.gaussians.map(lambda t: t.clone().requires_grad_())
    offset = case.offset.clone().requires_grad_()
    render = rasterize(
        Gaussians(**dict(gaussians.items())),
        case.camera,
        background=case.background,
        opacity_factors=case.factors,
        means2d_offset=offset,
    )
    target = Target.of(torch.full_like(render.rgb.detach(), 0.4))
    loss = photometric_loss(render.rgb, target, 0.2) + 0.01 * render.depth.mean()
    loss.backward()
    tensors = [render.rgb, render.alpha, render.depth, render.radii, loss, offset.grad]
    tensors += [tensor.grad for _, tensor in gaussians.items()]
    if fisher:
        information = fisher_information(case.gaussians, case.camera)
        tensors += [information.block, information.diagonal]
    assert all(tensor is not None for tensor in tensors)
    return [tensor for tensor in tensors if tensor is not None]


if __name__ == "__main__":
    print(render_bits(int(sys.argv[1]), fisher=False))
