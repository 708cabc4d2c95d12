"""The gradient that training takes directly is that of autograd, bit for bit."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from framework.compute.parallel import set_threads
from framework.errors import UserError
from framework.kernels import ScreenGradient, render_gradient
from framework.train.depth_priors import DepthSmoothness
from framework.train.epoch import Items
from framework.train.gradient import Rendering, ViewGradient, view_gradient
from framework.train.guard import Diverged
from framework.train.optim import Adam
from framework.types import Gaussians, View
from tests.numerics.scenes import Case, crowded_case, random_case

RATES = {"means": 1e-3, "quats": 1e-3, "log_scales": 5e-3, "opacity_logits": 0.05}
RATES |= {"sh0": 2.5e-3, "shN": 1.25e-4}


@pytest.fixture(autouse=True)
def _restore_threads() -> Iterator[None]:
    yield
    set_threads(0)


def bits(actual: ViewGradient) -> list[Any]:
    loss, gradients, stats = actual
    tensors = [*gradients.values(), stats.means2d_grad, stats.radii]
    return [loss, list(gradients), *(tensor.numpy().tobytes() for tensor in tensors)]


@pytest.mark.parametrize("smooth", [0.0, 0.5])
@pytest.mark.parametrize("weight", [1.0, 0.3])
@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize("seed", range(4))
def test_direct_is_autograd(seed: int, masked: bool, weight: float, smooth: float) -> None:
    case = random_case(seed) if seed < 3 else crowded_case(seed)
    draw = torch.Generator().manual_seed(seed)
    size = (case.camera.height, case.camera.width)
    mask = (torch.rand(size, generator=draw) > 0.3).float() if masked else None
    image = torch.rand((3, *size), generator=draw)
    view = View("v", case.camera, image, mask=mask, weight=weight)
    items = Items(smoothness=DepthSmoothness(smooth, 0.1) if smooth else None)
    item, params = items.get(view, 1), case.gaussians.map(lambda t: t.requires_grad_())
    rendering = Rendering(case.background, case.sh_degree, 0.2, case.factors)
    direct = view_gradient(params, item, "here", rendering)
    by_autograd = view_gradient(params, item, "here", rendering, lambda view, render: 0.0)
    assert bits(direct) == bits(by_autograd)
    assert direct[1]["means"].abs().sum() > 0
    rough = view_gradient(params, replace(item, smoothing=None), "here", rendering)
    assert (bits(rough) == bits(direct)) == (smooth == 0)
    assert rough[0] == direct[0]  # the reported loss is that of the photo
    assert (direct[2].height, direct[2].width) == size


@pytest.mark.parametrize("penalty", [None, lambda view, render: 0.0])
def test_a_loss_that_is_not_finite_is_told_and_the_next_is_as_ever(penalty: Any) -> None:
    case = random_case(1)
    image = torch.rand((3, case.camera.height, case.camera.width))
    item = Items().get(View("v", case.camera, image), 1)
    broken = Items().get(View("v", case.camera, torch.full_like(image, torch.nan)), 1)
    params = case.gaussians.map(lambda t: t.requires_grad_())
    before = bits(view_gradient(params, item, "here", Rendering(), penalty))
    with pytest.raises(Diverged, match="here: expected a finite loss, got nan"):
        view_gradient(params, broken, "here", Rendering(), penalty)
    assert bits(view_gradient(params, item, "here", Rendering(), penalty)) == before


@pytest.mark.parametrize("change", [lambda rgb: rgb[:, :-1], lambda rgb: rgb.astype(np.float64)])
def test_a_gradient_that_does_not_fit_is_refused(change: Any) -> None:
    """Kernels do not check bounds, and compile again for another type."""
    case = random_case(1)
    with pytest.raises(UserError, match=r"expected a float32 gradient of shape \[3, 47, 33\]"):
        render_gradient(case.gaussians, case.camera, change)


def on_screen(gaussians: Gaussians, case: Case, degree: int | None = None) -> ScreenGradient:
    """The gradient of a loss that differs in every pixel."""
    return render_gradient(
        gaussians,
        case.camera,
        lambda rgb: np.sin(1e3 * rgb).astype(np.float32),
        background=case.background,
        opacity_factors=case.factors,
        sh_degree=degree,
        near=0.2,
    )


def bits_of(gaussians: Gaussians) -> list[bytes]:
    return [tensor.numpy().tobytes() for _, tensor in gaussians.items()]


@pytest.mark.parametrize("threads", [1, 2, 3])
@pytest.mark.parametrize("degree", range(4))
def test_an_update_from_the_screen_is_that_of_the_whole_gradient(degree: int, threads: int) -> None:
    """Parameters, moments and what capacity plugins see; in blocks of more than one piece, some of
    whose Gaussians have no bands above 0, or are not seen."""
    set_threads(threads)
    case = random_case(degree, n=9001, footprint=1.0)
    whole = case.gaussians.replace(shN=case.gaussians.shN[:5003].contiguous())
    pieces = whole.clone()
    by_step, from_screen = Adam(whole), Adam(pieces)
    for decay in (1.0, 0.9, 0.9):
        gradient = on_screen(whole, case)
        tensors, means2d = gradient.pull_back()
        assert by_step.step(whole, tensors, RATES, decay) == ()
        actual = on_screen(pieces, case)
        assert torch.equal(actual.radii, gradient.radii)
        broken, seen = from_screen.step_from(actual, RATES, decay)
        assert broken == () and torch.equal(seen, means2d)
        assert bits_of(pieces) == bits_of(whole)
    assert seen.abs().sum() > 0 and (actual.radii == 0).any()
    one, other = by_step.state(), from_screen.state()
    assert one.steps == other.steps
    assert bits_of(one.first) == bits_of(other.first)
    assert bits_of(one.second) == bits_of(other.second)


def test_bands_that_open_late_have_the_bits_of_those_updated_all_along() -> None:
    """Bands without a gradient are passed over; once they had one they are not, whatever the degree
    of the step is and whatever optimizer follows."""
    case = random_case(3, n=900, footprint=1.0)
    whole, pieces = case.gaussians.clone(), case.gaussians.clone()
    by_step, from_screen = Adam(whole), Adam(pieces)
    for degree in (0, 0, 2, 0, 3, 0):
        tensors, _ = on_screen(whole, case, degree).pull_back()
        by_step.step(whole, tensors, RATES)
        from_screen.step_from(on_screen(pieces, case, degree), RATES)
        assert bits_of(pieces) == bits_of(whole)
        kept, from_screen = from_screen.state(), Adam(pieces)
        from_screen.load(kept)
    assert not torch.equal(whole.shN, case.gaussians.shN)


def test_a_gradient_is_used_once() -> None:
    case = random_case(1)
    actual = on_screen(case.gaussians, case)
    actual.pull_back()
    with pytest.raises(RuntimeError, match="this gradient was already used"):
        Adam(case.gaussians).step_from(actual, RATES)
