"""SHA-256 of a render, its loss and all gradients; `python -m tests.laws.render_bits THREADS`."""

from __future__ import annotations

import hashlib
import sys

import torch

from framework.losses import Target, photometric_loss
from framework.parallel import set_threads
from framework.rasterize import rasterize
from framework.types import Camera, Gaussians
from tests.numerics.scenes import random_case


def render_bits(threads: int) -> str:
    """Digest of what a training step computes with `threads` kernel threads."""
    set_threads(threads)
    try:
        return _digest()
    finally:
        set_threads(0)


def _digest() -> str:
    case = random_case(3, n=600)
    small = case.camera
    camera = Camera(small.viewmat, small.K * 1.0, small.width * 3, small.height * 3)
    gaussians = case.gaussians.map(lambda t: t.clone().requires_grad_())
    offset = case.offset.clone().requires_grad_()
    render = rasterize(
        Gaussians(**dict(gaussians.items())),
        camera,
        background=case.background,
        opacity_factors=case.factors,
        means2d_offset=offset,
    )
    target = Target.of(torch.full_like(render.rgb.detach(), 0.4))
    loss = photometric_loss(render.rgb, target, 0.2) + 0.01 * render.depth.mean()
    loss.backward()
    tensors = [render.rgb, render.alpha, render.depth, render.radii, loss, offset.grad]
    tensors += [tensor.grad for _, tensor in gaussians.items()]
    sha = hashlib.sha256()
    for tensor in tensors:
        assert tensor is not None
        sha.update(tensor.detach().contiguous().numpy().tobytes())
    return sha.hexdigest()


if __name__ == "__main__":
    print(render_bits(int(sys.argv[1])))
