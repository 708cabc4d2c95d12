"""Arithmetic of lanes: operators, comparisons, masks and constants."""

from __future__ import annotations

import math
import operator
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import overload

from framework.compute.simd.vector import (
    F32,
    I1,
    I32,
    INTS,
    LANES,
    VECTOR,
    M,
    V,
    VectorType,
    call,
    constant,
    elementwise,
    intrinsic,
)


def fused(builder: Any, x: Any, y: Any, z: Any) -> Any:
    return call(builder, "llvm.fma.v16f32", VECTOR, [x, y, z])


def _smaller(builder: Any, x: Any, y: Any) -> Any:
    return builder.select(builder.fcmp_ordered("<", x, y), x, y)


fma = elementwise(3, V, fused)  # x * y + z, rounded once
fnma = elementwise(3, V, lambda b, x, y, z: fused(b, b.fneg(x), y, z))  # z - x * y
minimum = elementwise(2, V, _smaller)  # y where x is not a number
maximum = elementwise(2, V, lambda b, x, y: b.select(b.fcmp_ordered(">", x, y), x, y))
neg = elementwise(1, V, lambda b, x: b.fneg(x))
floor = elementwise(1, V, lambda b, x: call(b, "llvm.floor.v16f32", VECTOR, [x]))
ceil = elementwise(1, V, lambda b, x: call(b, "llvm.ceil.v16f32", VECTOR, [x]))
absolute = elementwise(1, V, lambda b, x: call(b, "llvm.fabs.v16f32", VECTOR, [x]))
greater_equal = elementwise(2, M, lambda b, x, y: b.fcmp_ordered(">=", x, y))
greater = elementwise(2, M, lambda b, x, y: b.fcmp_ordered(">", x, y))
both = elementwise(2, M, lambda b, x, y: b.and_(x, y), M)
but_not = elementwise(2, M, lambda b, x, y: b.and_(x, b.not_(y)), M)
select = elementwise(3, V, lambda b, m, x, y: b.select(m, x, y), M)  # m ? x : y

for _operator, _instruction in (
    (operator.add, "fadd"),
    (operator.sub, "fsub"),
    (operator.mul, "fmul"),
    (operator.truediv, "fdiv"),
    (operator.iadd, "fadd"),
    (operator.isub, "fsub"),
):
    _binary = elementwise(2, V, lambda b, x, y, name=_instruction: getattr(b, name)(x, y))

    # numba wants the same argument list, annotations included, in both of these
    def _bind(binary: Any) -> Any:
        def typed(x, y):  # type: ignore[no-untyped-def]
            if isinstance(x, VectorType) and isinstance(y, VectorType):
                return lambda x, y: binary(x, y)
            if isinstance(x, VectorType) and y == types.float32:
                return lambda x, y: binary(x, splat(y))
            if isinstance(y, VectorType) and x == types.float32:
                return lambda x, y: binary(splat(x), y)
            return None

        return typed

    overload(_operator)(_bind(_binary))


@overload(operator.neg)
def _negative(x):  # type: ignore[no-untyped-def]
    return (lambda x: neg(x)) if isinstance(x, VectorType) else None


_root = elementwise(1, V, lambda b, x: call(b, "llvm.sqrt.v16f32", VECTOR, [x]))


@overload(math.sqrt)
def _square_root(x):  # type: ignore[no-untyped-def]
    return (lambda x: _root(x)) if isinstance(x, VectorType) else None


@intrinsic
def splat(typing_context, x):  # type: ignore[no-untyped-def]
    """All lanes = the float32 scalar x (anything else is refused, so that nothing widens)."""
    if x != types.float32:
        return None

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        undefined = ir.Constant(VECTOR, ir.Undefined)
        one = builder.insert_element(undefined, values[0], ir.Constant(I32, 0))
        return builder.shuffle_vector(one, undefined, ir.Constant(INTS, [0] * LANES))

    return V(types.float32), generate


@intrinsic
def iota(typing_context):  # type: ignore[no-untyped-def]
    """0, 1, ..., 15."""
    lanes = ir.Constant(VECTOR, [ir.Constant(F32, float(i)) for i in range(LANES)])
    return V(), lambda context, builder, signature, values: lanes


@intrinsic
def zeros(typing_context):  # type: ignore[no-untyped-def]
    """All lanes 0."""
    return V(), lambda context, builder, signature, values: constant(0.0)


@intrinsic
def any_lane(typing_context, mask):  # type: ignore[no-untyped-def]
    """True if a lane of the mask is set."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        bits = ir.IntType(LANES)
        return builder.icmp_unsigned("!=", builder.bitcast(values[0], bits), ir.Constant(bits, 0))

    return types.boolean(M), generate


@intrinsic
def lowest_bit(typing_context, bits):  # type: ignore[no-untyped-def]
    """Index of the lowest set bit of an int64 that is not 0."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return builder.cttz(values[0], ir.Constant(I1, 1))

    return types.int64(types.int64), generate
