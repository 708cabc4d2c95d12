"""What can be tested of the package gsplat without a GPU.

Its functions take what we give them, and its own versions in torch compute what the stand-in of the
other tests does.
"""

import inspect
from collections.abc import Iterator
from pathlib import Path
from types import FunctionType
from typing import Any
from unittest.mock import patch

import pytest
import torch

from framework.backends.gsplat_gpu import VERSION
from tests.backends import stand_in
from tests.backends.stand_in import StandIn
from tests.backends.test_contract import how, scene

gsplat = pytest.importorskip("gsplat", reason="gsplat is an extra; its Python code needs no CUDA")
wrapper = pytest.importorskip("gsplat.cuda._wrapper")
in_torch = pytest.importorskip("gsplat.cuda._torch_impl")
Calls = dict[str, tuple[tuple[Any, ...], dict[str, Any], Any]]


class OnCPU(StandIn):
    @property
    def device(self) -> str:
        return "cpu"


@pytest.fixture
def calls() -> Iterator[Calls]:
    """Arguments and result of each function in a render of a scene that is seen by the
    stand-in."""
    case, actual = scene(3), {}

    def spied(function: FunctionType) -> Any:
        def call(*args: Any, **kwargs: Any) -> Any:
            result = function(*args, **kwargs)
            actual[function.__name__] = args, kwargs, result
            return result

        return call

    spies = {f.__name__: spied(f) for f in stand_in.FUNCTIONS}
    with patch.multiple("gsplat", **spies):
        OnCPU().render(case.gaussians, case.camera, **how(case))
    assert len(actual) == len(stand_in.FUNCTIONS)
    yield actual


def test_it_is_the_version_that_is_pinned() -> None:
    assert gsplat.__version__ == VERSION


@pytest.mark.parametrize("function", stand_in.FUNCTIONS, ids=lambda f: f.__name__)
def test_the_parameters_are_those_of_the_stand_in(function: FunctionType) -> None:
    """Names, order and defaults agree; the package may have further parameters."""
    assert getattr(gsplat, function.__name__) is getattr(wrapper, function.__name__)
    ours = inspect.signature(function).parameters.values()
    theirs = inspect.signature(getattr(gsplat, function.__name__)).parameters.values()
    assert [(p.name, p.default) for p in ours] == [(p.name, p.default) for p in theirs]


@pytest.mark.parametrize("name", [f.__name__ for f in stand_in.FUNCTIONS])
def test_our_arguments_pass_its_checks(calls: Calls, name: str) -> None:
    """Shapes, types and contiguity are valid: each function reaches its kernel."""

    class AtTheKernel(Exception):
        pass

    def kernel(*_: Any) -> Any:
        raise AtTheKernel

    args, kwargs, _ = calls[name]
    with (
        patch.object(wrapper, "_make_lazy_cuda_func", lambda _: kernel),
        patch.object(wrapper, "_make_lazy_cuda_obj", lambda _: kernel),
        pytest.raises(AtTheKernel),
    ):
        getattr(wrapper, name)(*args, **kwargs)


def test_its_projection_is_the_stand_ins(calls: Calls) -> None:
    (means, _, quats, scales, viewmats, Ks, *size), options, ours = calls["fully_fused_projection"]
    covars, _ = in_torch._quat_scale_to_covar_preci(quats, scales, compute_preci=False)
    reference = {k: v for k, v in options.items() if k != "opacities"}
    theirs = in_torch._fully_fused_projection(means, covars, viewmats, Ks, *size, **reference)
    seen = (ours[0] > 0).all(-1)
    assert seen.float().mean() > 0.5
    for mine, other in zip(ours[1:4], theirs[1:4], strict=True):
        assert torch.allclose(mine[seen], other[seen], rtol=1e-3, atol=1e-4)
    # its kernels make boxes smaller by the opacity, its version in torch does not
    assert (ours[0][seen] <= theirs[0][seen]).all()


def test_its_kernels_have_the_constants_that_the_stand_in_has() -> None:
    """Read from the sources that it compiles."""
    source = Path(gsplat.__file__).parent / "cuda"
    blending = (source / "csrc" / "RasterizeToPixels3DGSFwd.cu").read_text(encoding="utf-8")
    projecting = (source / "csrc" / "ProjectionEWA3DGSFused.cu").read_text(encoding="utf-8")
    common = (source / "include" / "Common.h").read_text(encoding="utf-8")
    assert stand_in.ALPHA_MIN == 1 / 255 and "#define ALPHA_THRESHOLD (1.f / 255.f)" in common
    assert f"min({stand_in.ALPHA_MAX}f, " in blending and "alpha < ALPHA_THRESHOLD" in blending
    assert stand_in.LEAST_LIGHT == 1e-4 and "next_T <= 1e-4f" in blending
    assert f"float extend = {stand_in.EXTEND}f" in projecting
