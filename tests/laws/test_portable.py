"""The portable functions against NumPy's, SciPy's and the definitions."""

import math

import numpy as np
import pytest
import torch

from framework.compute import portable, tensors
from framework.compute.rng import stream

DRAW = stream(0, "tests/portable")
EDGES = np.array([0.0, math.inf, math.nan])


@pytest.mark.parametrize(
    ("ours", "numpys", "values"),
    [
        (portable.exp, np.exp, np.append(DRAW.uniform(-745, 709, 3000), [*EDGES, -np.inf, 710])),
        (portable.log, np.log, np.append(np.exp(DRAW.uniform(-740, 700, 3000)), [*EDGES, -1.0])),
        (portable.log1p, np.log1p, np.append(10 ** DRAW.uniform(-300, 300, 3000), EDGES)),
        (portable.arctan, np.arctan, np.append(DRAW.normal(0, 3, 3000), [0.0, np.inf, -np.inf])),
    ],
)
def test_functions_agree_with_numpys(ours, numpys, values) -> None:  # type: ignore[no-untyped-def]
    with np.errstate(all="ignore"):
        np.testing.assert_allclose(ours(values), numpys(values), rtol=2e-15, atol=5e-324)
    assert ours(2.0).shape == () and ours(np.ones((2, 3))).shape == (2, 3)


@pytest.mark.parametrize("exponent", [0.0, 0.5, 0.7, 1.0, 2.4])
def test_powers_agree_with_numpys(exponent: float) -> None:
    x = np.append(DRAW.uniform(0, 3, 1000), 0.0)
    np.testing.assert_allclose(portable.power(x, exponent), x**exponent, rtol=2e-15)
    np.testing.assert_array_equal(
        portable.power(x, np.full_like(x, exponent)), portable.power(x, exponent)
    )


def test_sine_and_cosine_of_a_turn_and_more() -> None:
    for x in (1e-9, 0.3, math.pi / 2, 3.0, 6.0):
        sinc, cosine = portable.sinc_cosine(x * x)
        assert sinc * x == pytest.approx(math.sin(x), abs=1e-14)
        assert cosine == pytest.approx(math.cos(x), abs=1e-14)


def test_matrices_agree_with_numpys() -> None:
    a, b = DRAW.normal(size=(5, 3, 3)), DRAW.normal(size=(5, 3, 2))
    np.testing.assert_allclose(portable.product(a, b), a @ b, atol=1e-14)
    np.testing.assert_allclose(portable.product(a[0], b[0, :, 0]), a[0] @ b[0, :, 0], atol=1e-14)
    np.testing.assert_allclose(portable.inverse(a[0]) @ a[0], np.eye(3), atol=1e-12)
    pose = np.eye(4)
    pose[:3] = DRAW.normal(size=(3, 4))
    np.testing.assert_allclose(portable.inverse(pose) @ pose, np.eye(4), atol=1e-12)
    blocks = a @ a.transpose(0, 2, 1) + 0.1 * np.eye(3)
    np.testing.assert_allclose(portable.inverses(blocks), np.linalg.inv(blocks), rtol=1e-9)
    np.testing.assert_allclose(portable.log_det(blocks), np.linalg.slogdet(blocks)[1], rtol=1e-9)


@pytest.mark.parametrize("kind", [torch.float32, torch.float64])
def test_roots_of_tensors_are_rounded_right(kind: torch.dtype) -> None:
    x = torch.from_numpy(10 ** DRAW.uniform(-30, 30, 5000)).to(kind)
    root = tensors.root(x).double().numpy()
    assert root.dtype == np.float64 and tensors.root(x).dtype == kind
    # the nearest number of its type: the squares of the middles to both neighbours enclose x
    ulp = np.spacing(tensors.root(x).numpy()).astype(np.longdouble)
    low, high = ((root.astype(np.longdouble) + s * ulp / 2) ** 2 for s in (-1, 1))
    exact = x.double().numpy().astype(np.longdouble)
    assert (low <= exact).all() and (exact <= high).all()


def test_log_determinants_stay_finite_where_rounding_cancels_a_pivot() -> None:
    columns = 1e9 * np.random.default_rng(0).normal(size=(1000, 6, 3))
    blocks = columns @ columns.transpose(0, 2, 1) + np.eye(6)
    assert np.isfinite(portable.log_det(blocks, least=1.0)).all()


@pytest.mark.parametrize(
    ("ours", "torchs"),
    [(tensors.root, torch.sqrt), (tensors.exp, torch.exp), (tensors.sigmoid, torch.sigmoid)],
)
def test_functions_of_tensors_and_their_gradients(ours, torchs) -> None:  # type: ignore[no-untyped-def]
    for shape in ((), (0,), (5, 3)):
        x = torch.from_numpy(DRAW.uniform(0.1, 2, shape)).requires_grad_()
        torch.testing.assert_close(ours(x), torchs(x))
        assert torch.autograd.gradcheck(ours, x)
    wide = torch.from_numpy(DRAW.uniform(0.1, 2, (4, 6)))[:, ::2]
    torch.testing.assert_close(ours(wide.float()), torchs(wide.float()))


def test_functions_of_tensors_elsewhere_are_pytorchs() -> None:
    there = torch.ones(3, device="meta", requires_grad=True)  # of a device that NumPy cannot read
    for ours in (tensors.root, tensors.exp, tensors.sigmoid):
        assert ours(there).device == there.device
