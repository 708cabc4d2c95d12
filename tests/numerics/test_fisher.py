"""Fisher information of the kernels (float32) against brute force and against laws.

Brute force: the Jacobian of every pixel and channel by forward-mode autograd of the float64
reference, its outer products summed. The scenes keep away from the blending thresholds, where one
pixel more or less is lawful.
"""

from functools import cache
from typing import Any

import pytest
import torch
from torch import Tensor

from framework.errors import UserError
from framework.fisher.information import FisherInformation, fisher_information
from framework.fisher.scores import block_prior, information_gains, uncertainty
from framework.kernels.reference import cutoff_margin, project, rasterize_reference
from framework.types import Camera, Gaussians
from tests.numerics.scenes import Case, random_case

SEEDS = range(20)
PARAMETERS = {"means": 3, "log_scales": 3, "quats": 4, "opacity_logits": 1, "sh0": 3}
TOLERANCE = 1e-4


@cache
def scene(seed: int) -> Case:
    """Twelve Gaussians, some of them opaque; SH degree seed % 4, with strong view dependence."""
    case = random_case(seed, n=12)
    g = case.gaussians
    opaque = g.opacity_logits + 4.0 * (torch.arange(12) % 4 == 0)
    full = case.camera
    camera = Camera(full.viewmat, full.K, min(full.width, 30), min(full.height, 24))
    return Case(
        g.replace(opacity_logits=opaque, shN=2 * g.shN),
        camera,
        case.background,
        case.factors,
        case.offset,
        case.sh_degree,
    )


def double(gaussians: Gaussians) -> Gaussians:
    return gaussians.map(lambda t: t.double())


def brute_force(case: Case, sh_degree: int | None = None, mask: Tensor | float = 1.0) -> Tensor:
    """[N, 14, 14] float64: the blocks of J^T J in the order of PARAMETERS."""
    gaussians = double(case.gaussians)

    def pixels(*values: Tensor) -> Tensor:
        changed: dict[str, Any] = dict(zip(PARAMETERS, values, strict=True))
        render = rasterize_reference(
            gaussians.replace(**changed),
            case.camera,
            background=case.background,
            sh_degree=sh_degree,
        )
        return (render.rgb * mask).flatten()

    inputs = tuple(getattr(gaussians, name) for name in PARAMETERS)
    jacobians = torch.autograd.functional.jacobian(
        pixels, inputs, vectorize=True, strategy="forward-mode"
    )
    n = len(gaussians)
    jacobian = torch.cat([j.reshape(len(j), n, -1) for j in jacobians], dim=2)
    return torch.einsum("pni,pnj->nij", jacobian, jacobian)


def information(
    case: Case, sh_degree: int | None = None, mask: Tensor | None = None
) -> FisherInformation:
    return fisher_information(
        case.gaussians, case.camera, background=case.background, sh_degree=sh_degree, mask=mask
    )


def group_scale(diagonal: Tensor) -> Tensor:
    """[N, 14]: of every parameter the root of its group's largest information, so that errors are
    judged in units of what is known about the mean, the log-scales, ..."""
    groups = torch.split(diagonal, list(PARAMETERS.values()), dim=1)
    return torch.cat([g.amax(1, keepdim=True).expand_as(g) for g in groups], dim=1).sqrt()


def assert_equal(ours: FisherInformation, exact: Tensor) -> None:
    diagonal = exact.diagonal(dim1=1, dim2=2)
    seen = diagonal[:, 10] > 0
    assert not ours.block[~seen].any() and not ours.diagonal[~seen].any()
    scale = group_scale(diagonal)[seen]
    error = (ours.diagonal.double() - diagonal)[seen].abs() / (scale**2).clamp(min=1e-30)
    assert error.max() <= TOLERANCE, f"diagonal: {error.amax(0).tolist()}"
    products = scale[:, :6, None] * scale[:, None, :6]
    error = (ours.block.double() - exact[:, :6, :6])[seen].abs() / products
    assert error.max() <= TOLERANCE, f"block: {error.max():.1e}"
    assert torch.equal(ours.block, ours.block.mT)


@pytest.mark.parametrize("seed", SEEDS)
def test_equals_the_sum_of_the_pixels_outer_products(seed: int) -> None:
    case = scene(seed)
    margin = cutoff_margin(project(double(case.gaussians), case.camera), case.camera)
    assert margin.min() > 1e-5, "a pixel at a cut-off: choose another scene"
    assert_equal(information(case), brute_force(case))


@pytest.mark.parametrize("seed", SEEDS[:4])
def test_what_a_mask_leaves_out_tells_nothing(seed: int) -> None:
    case = scene(seed)
    draws = torch.Generator().manual_seed(seed)
    mask = (torch.rand(case.camera.height, case.camera.width, generator=draws) > 0.3).float()
    assert_equal(information(case, mask=mask), brute_force(case, mask=mask))
    whole, ones = information(case), information(case, mask=torch.ones_like(mask))
    assert torch.equal(whole.block, ones.block) and torch.equal(whole.diagonal, ones.diagonal)
    for wrong in (mask[1:], mask.double()):
        with pytest.raises(UserError, match="mask of shape"):
            information(case, mask=wrong)


def test_what_does_not_fit_is_refused() -> None:
    """The kernels check no bounds."""
    case = scene(0)
    for wrong in (
        case.gaussians.map(Tensor.double),
        case.gaussians.replace(sh0=torch.zeros(1, 1, 3)),
    ):
        with pytest.raises(UserError):
            fisher_information(wrong, case.camera)
    with pytest.raises(UserError, match="background"):
        fisher_information(case.gaussians, case.camera, background=torch.zeros(4))


@pytest.mark.parametrize(("length", "width"), [(0.5, 0.01), (2.0, 0.003), (8.0, 0.002)])
def test_needles(length: float, width: float) -> None:
    """Up to hundreds of pixels long and thinner than one: the information on each of their
    parameters, which would be lost if the moments were taken along the image's axes."""
    n = 6
    draw = torch.Generator().manual_seed(int(1000 * width))
    u = torch.rand(n, 3, generator=draw)
    sizes = torch.tensor([length, width, width]).log() + 0.3 * torch.rand(n, 3, generator=draw)
    gaussians = Gaussians(
        means=u * torch.tensor([1.2, 0.9, 2.0]) + torch.tensor([-0.6, -0.45, 3.0]),
        quats=torch.randn(n, 4, generator=draw),
        log_scales=sizes,
        opacity_logits=torch.linspace(-1.5, 0.5, n),
        sh0=2 * torch.rand(n, 1, 3, generator=draw) - 1,
        shN=torch.zeros(n, 0, 3),
    )
    K = torch.tensor([[90.0, 0, 48], [0, 90, 36], [0, 0, 1]])
    camera = Camera(torch.eye(4), K, 96, 72)
    case = Case(gaussians, camera, torch.zeros(3), torch.ones(n), torch.zeros(n, 2), 0)
    exact, ours = brute_force(case).diagonal(dim1=1, dim2=2), information(case).diagonal.double()
    assert (exact[:, :6] > 0).all(), "all are seen"
    assert ((ours - exact).abs() / exact.clamp(min=1e-9)).max() < 1e-3


def test_active_degree_below_the_stored_one() -> None:
    for degree in range(3):
        assert_equal(information(scene(3), degree), brute_force(scene(3), degree))


@pytest.mark.parametrize("seed", [0, 1, 2, 3])
def test_one_view_cannot_tell_size_from_distance(seed: int) -> None:
    """Away from the camera by a share, and larger by the same share: the same picture."""
    case = scene(seed)
    away = case.gaussians.means - case.camera.center
    blind = torch.cat([away, torch.ones_like(away)], dim=1).double()
    block = information(case).block.double()
    size = block.diagonal(dim1=1, dim2=2).sqrt() * blind.abs()
    left = torch.einsum("nij,nj->ni", block, blind)
    bound = size.sum(1, keepdim=True) * block.diagonal(dim1=1, dim2=2).sqrt()
    assert (left.abs() <= TOLERANCE * bound).all()


def test_nothing_in_view() -> None:
    case = scene(3)
    behind = torch.diag(torch.tensor([-1.0, 1.0, -1.0, 1.0]).double()) @ case.camera.viewmat
    kept = case.gaussians[information(case).visible]
    camera = Camera(behind, case.camera.K, case.camera.width, case.camera.height)
    away = fisher_information(kept, camera)
    assert not away.visible.any() and not away.block.any() and not away.diagonal.any()


def test_float32_blocks_give_the_exact_uncertainty() -> None:
    """Even after one view, where rounding fills the direction that nothing is known about."""
    for case in map(scene, SEEDS):
        ours, exact = information(case), brute_force(case)[:, :6, :6]
        if not ours.visible.any():
            continue
        scores = uncertainty(ours.block, ours.visible, 2.0, 1e-4)
        expected = uncertainty(exact, ours.visible, 2.0, 1e-4)
        assert torch.equal(scores.isinf(), ~ours.visible)
        torch.testing.assert_close(scores, expected, rtol=0, atol=0.1)


def scaled_scene(factor: float) -> tuple[Gaussians, list[Camera]]:
    """400 Gaussians before three cameras, all lengths times `factor`."""
    case = random_case(3, n=400)
    cameras = []
    for shift in (-0.3, 0.0, 0.3):
        viewmat = case.camera.viewmat.clone()
        viewmat[0, 3] += shift
        viewmat[:3, 3] *= factor
        cameras.append(Camera(viewmat, case.camera.K, case.camera.width, case.camera.height))
    g = case.gaussians
    log_scales = g.log_scales + torch.tensor(factor).log()
    return g.replace(means=g.means * factor, log_scales=log_scales), cameras


def scores(factor: float) -> tuple[Tensor, list[float]]:
    """Uncertainty after three views; gains of the middle one, trace and log, diagonal and block."""
    gaussians, cameras = scaled_scene(factor)
    views = [fisher_information(gaussians, c, near=0.01 * factor) for c in cameras]
    unit = torch.tensor([2.0 * factor] * 3 + [1.0] * 11).double()
    diagonals = [view.diagonal * unit**2 for view in views]
    blocks = [view.block * unit[:6, None] * unit[:6] for view in views]
    seen = torch.stack([view.visible for view in views]).any(0)
    total = torch.stack([view.block.double() for view in views]).sum(0)
    gains = []
    for form in ("trace", "log"):
        prior = block_prior(blocks, 1.0)
        gains += information_gains(blocks[1], [blocks[0], blocks[2]], prior, form)
        prior = diagonals[0].median(0).values.clamp(min=1e-3)
        gains += information_gains(diagonals[1], [diagonals[0], diagonals[2]], prior, form)
    return uncertainty(total, seen, 2.0 * factor, 1e-4), gains


def test_the_unit_of_length_changes_no_score() -> None:
    plain, gains = scores(1.0)
    large, large_gains = scores(1000.0)
    assert large_gains == pytest.approx(gains, rel=5e-3)
    assert torch.equal(plain.isinf(), large.isinf())
    change = (plain - large)[~plain.isinf()].abs()
    assert change.quantile(0.99) < 0.05 and change.max() < 0.3  # a pixel at a cut-off may change
    ordered = plain[large.argsort(stable=True)][: len(change)]
    assert (ordered.diff() > -0.3).all(), "only scores that are equal to rounding may change places"
