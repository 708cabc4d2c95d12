"""Functions of lanes: powers and logarithms to base 2, and sums over the lanes."""

from __future__ import annotations

import math
from typing import Any

from llvmlite import ir
from numba.core import cgutils

from framework.compute.simd.arithmetic import fused
from framework.compute.simd.vector import (
    I32,
    INTS,
    LANES,
    VECTOR,
    V,
    call,
    constant,
    elementwise,
    intrinsic,
)

# Polynomial of 2^f on [-1/2, 1/2], highest power first: least squares in float64, reweighted to the
# smallest maximal relative error; 1.6e-7 in float32.
_EXP2 = (0.00132647005, 0.00967151485, 0.0555073395, 0.240222424, 0.693147004, 1.0)


def _exp2(builder: Any, x: Any) -> Any:
    bounded = builder.select(builder.fcmp_ordered(">", x, constant(-125)), x, constant(-125))
    whole = call(builder, "llvm.rint.v16f32", VECTOR, [bounded])
    fraction = builder.fsub(bounded, whole)
    power = constant(_EXP2[0])
    for coefficient in _EXP2[1:]:
        power = fused(builder, power, fraction, constant(coefficient))
    shift = ir.Constant(INTS, [ir.Constant(I32, 23)] * LANES)
    exponent = builder.shl(builder.fptosi(whole, INTS), shift)
    return builder.bitcast(builder.add(builder.bitcast(power, INTS), exponent), VECTOR)


exp2 = elementwise(1, V, _exp2)  # for x < 127; x below -125 gives 2^-125

# log2(m) = s (c0 + c1 s^2 + ...), s = (m - 1) / (m + 1): the series of 2 artanh(s) / ln 2
_LOG2 = tuple(2 / math.log(2) / (2 * k + 1) for k in range(5))


def _log2(builder: Any, x: Any) -> Any:
    bits = builder.bitcast(x, INTS)
    # the exponent that leaves a mantissa in [sqrt(1/2), sqrt(2))
    half = ir.Constant(INTS, [ir.Constant(I32, 0x3F3504F3)] * LANES)
    shift = ir.Constant(INTS, [ir.Constant(I32, 23)] * LANES)
    exponent = builder.ashr(builder.sub(bits, half), shift)
    mantissa = builder.bitcast(builder.sub(bits, builder.shl(exponent, shift)), VECTOR)
    s = builder.fdiv(builder.fsub(mantissa, constant(1)), builder.fadd(mantissa, constant(1)))
    square = builder.fmul(s, s)
    series = constant(_LOG2[-1])
    for coefficient in _LOG2[-2::-1]:
        series = fused(builder, series, square, constant(coefficient))
    return fused(builder, s, series, builder.sitofp(exponent, VECTOR))


log2 = elementwise(1, V, _log2)  # for normal x > 0


def _fold(builder: Any, x: Any, y: Any, group: int) -> Any:
    """Halve every group of `group` lanes by adding its two halves; x's groups, then y's."""
    half = group // 2
    low = [g * group + i for g in range(2 * LANES // group) for i in range(half)]
    low_mask = ir.Constant(INTS, [ir.Constant(I32, i) for i in low])
    high_mask = ir.Constant(INTS, [ir.Constant(I32, i + half) for i in low])
    return builder.fadd(
        builder.shuffle_vector(x, y, low_mask), builder.shuffle_vector(x, y, high_mask)
    )


@intrinsic
def lane_sums(typing_context, vectors):  # type: ignore[no-untyped-def]
    """One vector whose lane i is the sum of the lanes of vectors[i], for a tuple of up to 16.

    A butterfly of shuffles and additions, which all the sums share.
    """

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        level = cgutils.unpack_tuple(builder, values[0])
        group = LANES
        while group > 1:
            if len(level) % 2:
                level = [*level, constant(0.0)]
            level = [_fold(builder, level[i], level[i + 1], group) for i in range(0, len(level), 2)]
            group //= 2
        return level[0]

    return V(vectors), generate
