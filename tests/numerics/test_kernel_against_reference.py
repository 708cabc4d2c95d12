"""The kernels (float32) against the reference (float64) on 20 random, 4 crowded and 2 wide scenes.

Pixels within a relative BAND of a blending threshold are left out of the image and of the loss,
because there the two may decide differently.
"""

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from framework.compute.rng import stream
from framework.kernels import rasterize
from framework.kernels.reference import cutoff_margin, project, rasterize_reference
from framework.types import Gaussians, Render
from tests.numerics.scenes import Case, crowded_case, random_case, wide_case

BAND = 1e-4  # float32 exponents here are off by up to about 1e-5
IMAGE_TOLERANCE = 1e-5
RANDOM = [random_case(seed) for seed in range(20)]
CROWDED = [crowded_case(seed) for seed in range(100, 104)]
WIDE = [wide_case(seed) for seed in (200, 201)]

Rasterizer = Callable[..., Render]
Inputs = dict[str, Tensor]


def _inputs(case: Case, dtype: torch.dtype) -> Inputs:
    """Fresh leaves of everything that is differentiated."""
    tensors = {**dict(case.gaussians.items()), "factors": case.factors, "offset": case.offset}
    return {name: t.to(dtype).clone().requires_grad_() for name, t in tensors.items()}


def _render(rasterizer: Rasterizer, case: Case, inputs: Inputs) -> Render:
    return rasterizer(
        Gaussians(**{name: inputs[name] for name, _ in case.gaussians.items()}),
        case.camera,
        background=case.background,
        opacity_factors=inputs["factors"],
        means2d_offset=inputs["offset"],
        near=0.2,
    )


def _off_cutoffs(case: Case) -> Tensor:
    """[H, W] bool: the pixels that both implementations must agree on."""
    seen = project(
        case.gaussians.map(lambda t: t.double()),
        case.camera,
        opacity_factors=case.factors.double(),
        near=0.2,
    )
    return cutoff_margin(seen, case.camera) > BAND


def _gradients(rasterizer: Rasterizer, case: Case, dtype: torch.dtype, used: Tensor) -> Inputs:
    """Gradients of a random linear function of colour, alpha and depth of the used pixels."""
    inputs = _inputs(case, dtype)
    render = _render(rasterizer, case, inputs)
    shape = (5, case.camera.height, case.camera.width)
    weights = torch.from_numpy(stream(shape[1] * shape[2], "test-weights").standard_normal(shape))
    planes = torch.cat([render.rgb, render.alpha[None], render.depth[None]])
    (planes * weights.to(dtype) * used).sum().backward()
    gradients = {name: t.grad for name, t in inputs.items() if t.numel()}
    return {name: g.double() for name, g in gradients.items() if g is not None}


@pytest.mark.parametrize("case", RANDOM + CROWDED + WIDE)
def test_images(case: Case) -> None:
    used = _off_cutoffs(case)
    kernel = _render(rasterize, case, _inputs(case, torch.float32))
    exact = _render(rasterize_reference, case, _inputs(case, torch.float64))
    left_out = int((~used).sum())
    assert left_out <= 0.05 * used.numel(), f"{left_out} of {used.numel()} pixels at a cut-off"
    for name, scale in (("rgb", 1.0), ("alpha", 1.0), ("depth", 6.0)):
        ours, theirs = getattr(kernel, name), getattr(exact, name)
        error = (ours - theirs).abs()[..., used].max() / scale
        assert error <= IMAGE_TOLERANCE, f"{name}: {error:.2e} off with {left_out} px left out"
    torch.testing.assert_close(kernel.radii, exact.radii, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("case", RANDOM + CROWDED + WIDE)
def test_gradients(case: Case) -> None:
    used = _off_cutoffs(case)
    kernel = _gradients(rasterize, case, torch.float32, used)
    exact = _gradients(rasterize_reference, case, torch.float64, used)
    assert kernel.keys() == exact.keys()
    for name, reference in exact.items():
        ours, theirs = kernel[name].flatten(), reference.flatten()
        assert theirs.norm() > 0, name
        distance = (ours - theirs).norm() / theirs.norm()
        cosine = torch.nn.functional.cosine_similarity(ours, theirs, dim=0)
        assert distance <= 1e-4 and cosine >= 0.9999, f"{name}: {distance:.2e}, cos {cosine:.7f}"


def test_gradients_have_no_bias() -> None:
    """Signed error over all scenes: rounding may scatter, it must not shrink or grow gradients."""
    along: dict[str, list[float]] = {}
    for case in RANDOM:
        used = _off_cutoffs(case)
        kernel = _gradients(rasterize, case, torch.float32, used)
        exact = _gradients(rasterize_reference, case, torch.float64, used)
        for name, g in exact.items():
            gain = float((kernel[name] * g).sum() / (g * g).sum()) - 1
            along.setdefault(name, []).append(gain)
    for name, gains in along.items():
        assert abs(sum(gains) / len(gains)) < 1e-5, f"{name}: mean gain error {gains}"


def test_pixels_at_the_cutoffs_stay_close() -> None:
    """At a cut-off the two may differ by one blended Gaussian of alpha 1/255, never by more."""
    for case in RANDOM + CROWDED:
        kernel = _render(rasterize, case, _inputs(case, torch.float32))
        exact = _render(rasterize_reference, case, _inputs(case, torch.float64))
        assert (kernel.alpha - exact.alpha).abs().max() < 1.5 / 255


def test_crowded_scenes_stop_pixels_early() -> None:
    """The scenes above do reach the transmittance stop, and the 0.99 clamp."""
    for case in CROWDED:
        exact = _render(rasterize_reference, case, _inputs(case, torch.float64))
        assert (1 - exact.alpha < 1e-3).sum() > 50
        assert (case.gaussians.opacities * case.factors > 0.99).any()


def test_active_degree_below_the_stored_one() -> None:
    case = random_case(3)
    for degree in range(4):
        kernel = rasterize(case.gaussians, case.camera, sh_degree=degree)
        used = _off_cutoffs_plain(case)
        exact = rasterize_reference(
            case.gaussians.map(lambda t: t.double()), case.camera, sh_degree=degree
        )
        assert (kernel.rgb - exact.rgb).abs()[:, used].max() <= IMAGE_TOLERANCE


def _off_cutoffs_plain(case: Case) -> Tensor:
    seen = project(case.gaussians.map(lambda t: t.double()), case.camera)
    return cutoff_margin(seen, case.camera) > BAND
