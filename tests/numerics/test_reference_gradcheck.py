"""float64 gradcheck of the reference, on pixels away from the blending thresholds."""

import torch
from torch import Tensor

from framework.kernels.reference import cutoff_margin, project, rasterize_reference
from framework.types import Gaussians
from tests.numerics.scenes import Case, random_case

MARGIN = 1e-3  # finite differences of 1e-6 move ln(alpha) by far less


def _check(case: Case, fast: bool) -> Tensor:
    """Gradcheck all inputs of one case; returns the [H, W] mask of the pixels that took part.

    fast: check random projections of the Jacobian instead of every entry.
    """
    gaussians = case.gaussians.map(lambda t: t.double())
    factors, offset = case.factors.double(), case.offset.double()
    seen = project(gaussians, case.camera, case.sh_degree, factors, offset)
    colors_off_clamp = (seen.colors == 0) | (seen.colors > 1e-3)
    assert colors_off_clamp.all(), "choose a scene whose colours are away from the clamp"
    used = cutoff_margin(seen, case.camera) > MARGIN
    inputs = {**dict(gaussians.items()), "factors": factors, "offset": offset}
    names = [name for name, tensor in inputs.items() if tensor.numel()]

    def images(*tensors: Tensor) -> tuple[Tensor, ...]:
        options = {**inputs, **dict(zip(names, tensors, strict=True))}
        render = rasterize_reference(
            Gaussians(**{name: options[name] for name, _ in gaussians.items()}),
            case.camera,
            background=case.background,
            opacity_factors=options["factors"],
            means2d_offset=options["offset"],
        )
        return render.rgb[:, used], render.alpha[used], render.depth[used]

    leaves = [inputs[name].clone().requires_grad_() for name in names]
    assert torch.autograd.gradcheck(images, leaves, fast_mode=fast, rtol=1e-5, atol=1e-7)
    return used


def test_every_entry_of_the_jacobian() -> None:
    _check(random_case(27, n=3), fast=False)  # 7x5 pixels, SH degree 3


def test_every_sh_degree() -> None:
    for seed in range(4):
        used = _check(random_case(seed, n=20), fast=True)
        assert used.float().mean() > 0.9


def test_opaque_pile_reaches_clamp_and_stop() -> None:
    """Many nearly opaque Gaussians: alpha is clamped at 0.99 and pixels stop early."""
    case = random_case(3, n=30, margin=-0.3)
    opaque = case.gaussians.replace(opacity_logits=case.gaussians.opacity_logits * 0 + 6.0)
    ones = torch.ones_like(case.factors)
    pile = Case(opaque, case.camera, case.background, ones, case.offset, case.sh_degree)
    used = _check(pile, fast=True)
    render = rasterize_reference(opaque.map(lambda t: t.double()), case.camera)
    assert ((1 - render.alpha < 2e-3) & used).sum() > 50, "no stopped pixel was checked"
