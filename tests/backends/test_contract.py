"""Every rasterizer gives what the kernels give: image, depth, radii, gradients, information."""

from collections.abc import Iterator
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from framework.backends import NUMBA, Rasterizer
from framework.kernels.reference import cutoff_margin, project
from framework.types import Render
from tests.backends.choices import NAMES, opened
from tests.numerics.scenes import Case, random_case

SEEDS = (3, 6)  # of SH degrees 3 and 2
LARGEST_LOGIT = 4.0  # opacity 0.982: gsplat's alphas end at 0.999, ours at 0.99
CLOSE = 1e-4


@pytest.fixture(params=NAMES)
def rasterizer(request: pytest.FixtureRequest) -> Iterator[Rasterizer]:
    yield from opened(request.param)


def scene(seed: int) -> Case:
    """Not so opaque, nor so far outside, that gsplat's constants matter; with as many bands as the
    seed says, and a third of the Gaussians without."""
    case = random_case(seed, n=60, margin=0.1)
    g = case.gaussians
    g = g.replace(opacity_logits=g.opacity_logits.clamp(max=LARGEST_LOGIT), shN=g.shN[:40])
    return replace(case, gaussians=g)


def how(case: Case) -> dict[str, object]:
    return {"background": case.background, "opacity_factors": case.factors}


def sure(case: Case) -> Tensor:
    """[H, W]: the pixels that no rounding brings over a cut-off."""
    exact = case.gaussians.map(lambda t: t.double())
    seen = project(exact, case.camera, opacity_factors=case.factors.double())
    return cutoff_margin(seen, case.camera) > 1e-4


@pytest.mark.parametrize("seed", SEEDS)
def test_images(rasterizer: Rasterizer, seed: int) -> None:
    case = scene(seed)
    ours = NUMBA.render(case.gaussians, case.camera, **how(case))
    theirs = rasterizer.render(case.gaussians, case.camera, **how(case)).to("cpu")
    at = sure(case)
    assert at.float().mean() > 0.9
    for name in ("rgb", "alpha", "depth"):
        error = (getattr(ours, name) - getattr(theirs, name))[..., at].abs().max()
        assert error < CLOSE * (10 if name == "depth" else 1), f"{name}: {error:.1e}"
    assert torch.allclose(ours.radii, theirs.radii, rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("degree", [0, None])
def test_gradients(rasterizer: Rasterizer, seed: int, degree: int | None) -> None:
    """The photometric loss with a mask, in every parameter and the projected means."""
    case = scene(seed)
    photo = torch.rand(3, case.camera.height, case.camera.width, generator=_draws(seed))
    mask = sure(case).float()

    def taken(who: Rasterizer) -> tuple[float, dict[str, Tensor], Tensor, Tensor]:
        target, loss = who.losses().target(photo, mask, who.device), 0.0

        def image_gradient(rgb: object) -> object:
            nonlocal loss
            loss, gradient = who.losses().loss_gradient(rgb, target, 0.2, 0.7)
            return gradient

        placed = case.gaussians.to(who.device)
        actual = who.render_gradient(
            placed, case.camera, image_gradient, sh_degree=degree, **how(case)
        )
        radii = actual.radii.cpu()
        tensors, means2d = actual.pull_back()
        return loss, {k: t.cpu() for k, t in tensors.items()}, means2d.cpu(), radii

    ours, theirs = taken(NUMBA), taken(rasterizer)
    assert ours[0] == pytest.approx(theirs[0], abs=2e-6)
    for name, gradient in (*ours[1].items(), ("means2d", ours[2])):
        other = theirs[2] if name == "means2d" else theirs[1][name]
        assert other.shape == gradient.shape
        error = (gradient - other).norm()
        assert error <= 2e-3 * gradient.norm() + 1e-9, f"{name}: {error / gradient.norm():.1e}"
    assert torch.allclose(ours[3], theirs[3], rtol=1e-3, atol=1e-3)


def _draws(seed: int) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def test_a_loss_of_all_that_is_rendered(rasterizer: Rasterizer) -> None:
    """Autograd through colours, alpha and depth, as for a regularizer's term."""
    case = scene(3)

    def taken(who: Rasterizer) -> list[Tensor]:
        leaves = case.gaussians.to(who.device).map(lambda t: t.detach().requires_grad_())
        offset = leaves.means.new_zeros(len(leaves), 2, requires_grad=True)
        at = sure(case).to(who.device)
        seen: Render = who.render(leaves, case.camera, means2d_offset=offset, **how(case))
        target = who.losses().target(torch.full((3, *at.shape), 0.4), None, who.device)
        term = who.losses().photometric_loss(seen.rgb * at, target, 0.2) + (seen.alpha * at).mean()
        term = term + 0.1 * (seen.depth * at).square().mean()
        tensors = [t for _, t in leaves.items()]
        return [g.cpu() for g in torch.autograd.grad(term, [*tensors, offset])]

    for ours, theirs in zip(taken(NUMBA), taken(rasterizer), strict=True):
        assert (ours - theirs).norm() <= 2e-3 * ours.norm() + 1e-9
