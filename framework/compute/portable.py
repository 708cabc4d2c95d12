"""Functions whose bits are the same on every processor, unlike those of NumPy, PyTorch and BLAS.

IEEE 754 defines the rounding of sums, products, quotients and square roots. Exponentials,
logarithms, powers and products of matrices differ in the last bit, since each library has separate
code for SSE, FMA, AVX2 and AVX-512. Here they are made of the former, in one order. Errors are a
few units in the last place of float64.
"""

import math
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic as numba_intrinsic
from numpy.typing import ArrayLike

# product and others: what plugins take from here
from framework.compute.elementary import Array, arctan, inverse, product, sinc_cosine  # noqa: F401
from framework.compute.jit import inlined, kernel

_intrinsic: Any = numba_intrinsic

LN2_HIGH, LN2_LOW = 6.93147180369123816490e-01, 1.90821492927058770002e-10  # 33 bits, the rest
LOG2E = 1.4426950408889634
LARGEST, SMALLEST = 709.782712893384, -745.1332191019412  # beyond: infinity, 0
SQRT_HALF_BITS = 0x3FE6A09E667F3BCD
_LEAST_NORMAL, _54_BITS = 2.2250738585072014e-308, 18014398509481984.0
_EXP = tuple(1 / math.factorial(k) for k in range(13, -1, -1))  # to 2e-18 on [-ln 2 / 2, ln 2 / 2]
_LOG = tuple(2 / (2 * k + 1) for k in range(10, -1, -1))  # of 2 artanh(s) / s, to 1e-18


@_intrinsic
def _bits(typing_context, x):
    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return builder.bitcast(values[0], ir.IntType(64))

    return types.int64(types.float64), generate


@_intrinsic
def _from_bits(typing_context, x):
    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return builder.bitcast(values[0], ir.DoubleType())

    return types.float64(types.int64), generate


@inlined
def exp_of(x):
    """e^x of a float64, in kernels."""
    if not (x <= LARGEST):
        return x * np.inf if x > 0 else x  # NaN stays
    if x < SMALLEST:
        return 0.0
    whole = math.floor(x * LOG2E + 0.5)
    rest = (x - whole * LN2_HIGH) - whole * LN2_LOW
    power = _EXP[0]
    for coefficient in _EXP[1:]:
        power = power * rest + coefficient
    exponent = np.int64(whole)
    half = exponent >> 1
    power *= _from_bits((half + 1023) << 52)
    return power * _from_bits((exponent - half + 1023) << 52)


@inlined
def log_of(x):
    """The natural logarithm of a float64, in kernels."""
    if not (x > 0) or x == np.inf:
        return -np.inf if x == 0 else (x if x == np.inf else np.nan)
    shift = 0
    if x < _LEAST_NORMAL:
        x *= _54_BITS
        shift = 54
    bits = _bits(x)
    exponent = (bits - SQRT_HALF_BITS) >> 52
    mantissa = _from_bits(bits - (exponent << 52))
    s = (mantissa - 1.0) / (mantissa + 1.0)
    square = s * s
    series = _LOG[0]
    for coefficient in _LOG[1:]:
        series = series * square + coefficient
    n = float(exponent - shift)
    return n * LN2_HIGH + (s * series + n * LN2_LOW)


@inlined
def power_of(x, y):
    """x^y of x >= 0, in kernels."""
    if y == 1.0:
        return x
    return 1.0 if y == 0.0 else exp_of(y * log_of(x))


@kernel
def _exp(x, out):
    for i in range(len(x)):
        out[i] = exp_of(x[i])


@kernel
def _log(x, out):
    for i in range(len(x)):
        out[i] = log_of(x[i])


@kernel
def _log1p(x, out):
    for i in range(len(x)):
        more = 1.0 + x[i]
        out[i] = log_of(more)
        if more < np.inf:  # what the sum lost
            out[i] += (x[i] - (more - 1.0)) / more if more > 0 else 0.0


@kernel
def _power(x, y, out):
    for i in range(len(x)):
        out[i] = power_of(x[i], y[i])


def _each(function: Any, x: ArrayLike, *more: Any) -> Array:
    values = np.ascontiguousarray(x, np.float64)
    out = np.empty_like(values)
    function(values.reshape(-1), *more, out.reshape(-1))
    return out.reshape(np.shape(x))


def exp(x: ArrayLike) -> Array:
    """e^x, float64 of the shape of x."""
    return _each(_exp, x)


def log(x: ArrayLike) -> Array:
    """The natural logarithm, float64 of the shape of x."""
    return _each(_log, x)


def log1p(x: ArrayLike) -> Array:
    """log(1 + x), float64 of the shape of x."""
    return _each(_log1p, x)


def power(x: ArrayLike, y: ArrayLike) -> Array:
    """x^y of x >= 0 and a number y or one for each, float64 of the shape of x."""
    exponents = np.broadcast_to(np.asarray(y, np.float64), np.shape(x))
    return _each(_power, x, np.ascontiguousarray(exponents).reshape(-1))


def sigmoid(x: ArrayLike) -> Array:
    """1 / (1 + e^-x), float64 of the shape of x."""
    rest: Array = 1 / (1 + exp(-np.asarray(x, np.float64)))
    return rest


def logit(p: ArrayLike) -> Array:
    """The x whose `sigmoid` is p in (0, 1), float64 of the shape of p."""
    return log(p) - log1p(-np.asarray(p, np.float64))


def log_det(blocks: ArrayLike, more: ArrayLike = 0.0, least: float = 0.0) -> Array:
    """[N] log determinants by the pivots of L D L^T of blocks [N, D, D].

    Args:
        blocks: positive semi-definite, or at least `least` times the identity.
        more: [N, D] >= 0, added to the diagonals.
        least: smaller pivots are rounding errors and become `least + more`.
    """
    a = np.array(np.moveaxis(np.asarray(blocks, np.float64), 0, -1), order="C")  # lanes: blocks
    total = np.zeros(a.shape[-1])
    added = np.broadcast_to(np.asarray(more, np.float64), a.shape[:0:-1])
    for i in range(len(a)):
        pivot = np.maximum(a[i, i] + added[:, i], least + added[:, i])
        total += log(pivot)
        for row in range(i + 1, len(a)):
            factor = a[row, i] / pivot
            for col in range(i + 1, row + 1):
                a[row, col] -= factor * a[col, i]
    return total


def inverses(blocks: ArrayLike) -> Array:
    """[N, D, D] inverses of positive definite blocks, by Gauss and Jordan's elimination."""
    a = np.array(np.moveaxis(np.asarray(blocks, np.float64), 0, -1), order="C")
    for i in range(len(a)):
        pivot = 1 / a[i, i]
        a[i, i] = 1.0
        a[i] *= pivot
        for row in range(len(a)):
            if row != i:
                factor = a[row, i].copy()
                a[row, i] = 0.0
                a[row] -= factor * a[i]
    return np.moveaxis(a, -1, 0)
