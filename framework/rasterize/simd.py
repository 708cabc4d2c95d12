"""Sixteen float32 lanes as a value inside numba kernels.

LLVM's auto-vectoriser gives up on the blending loops (branches, masks, many accumulators); an
explicit vector type does not depend on it. LLVM lowers it to one AVX-512, two AVX2 or four
SSE/NEON registers. Every operation is strict IEEE and every sum has a fixed order, so results have
the same bits on each of them.
"""

from __future__ import annotations

import operator
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic as numba_intrinsic
from numba.extending import models, overload, register_model
from numba.np.arrayobj import make_array

LANES = 16
intrinsic: Any = numba_intrinsic  # what it makes is typed by numba, not by its Python signature

_f32, _i32, _i1 = ir.FloatType(), ir.IntType(32), ir.IntType(1)
_vector = ir.VectorType(_f32, LANES)
_ints = ir.VectorType(_i32, LANES)
_mask = ir.VectorType(_i1, LANES)


class _VectorType(types.Type):
    def __init__(self) -> None:
        super().__init__(name="float32x16")


class _MaskType(types.Type):
    def __init__(self) -> None:
        super().__init__(name="mask16")


V, M = _VectorType(), _MaskType()


@register_model(_VectorType)
class _VectorModel(models.PrimitiveModel):
    def __init__(self, dmm: Any, fe_type: Any) -> None:
        super().__init__(dmm, fe_type, _vector)


@register_model(_MaskType)
class _MaskModel(models.PrimitiveModel):
    def __init__(self, dmm: Any, fe_type: Any) -> None:
        super().__init__(dmm, fe_type, _mask)


def _constant(value: float) -> ir.Constant:
    return ir.Constant(_vector, [ir.Constant(_f32, float(np.float32(value)))] * LANES)


def _call(builder: Any, name: str, result: Any, arguments: list[Any]) -> Any:
    signature = ir.FunctionType(result, [a.type for a in arguments])
    return builder.call(cgutils.get_or_insert_function(builder.module, signature, name), arguments)


def _elementwise(arity: int, result: Any, build: Any, first: Any = V) -> Any:
    """An intrinsic of `arity` vectors; `build(builder, *values)` emits the instructions."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return build(builder, *values)

    if arity == 1:

        @intrinsic
        def unary(typing_context, x):  # type: ignore[no-untyped-def]
            return result(first), generate

        return unary
    if arity == 2:

        @intrinsic
        def binary(typing_context, x, y):  # type: ignore[no-untyped-def]
            return result(first, first), generate

        return binary

    @intrinsic
    def ternary(typing_context, x, y, z):  # type: ignore[no-untyped-def]
        return result(first, V, V), generate

    return ternary


def _fma(builder: Any, x: Any, y: Any, z: Any) -> Any:
    return _call(builder, "llvm.fma.v16f32", _vector, [x, y, z])


def _smaller(builder: Any, x: Any, y: Any) -> Any:
    return builder.select(builder.fcmp_ordered("<", x, y), x, y)


fma = _elementwise(3, V, _fma)  # x * y + z, rounded once
fnma = _elementwise(3, V, lambda b, x, y, z: _fma(b, b.fneg(x), y, z))  # z - x * y
minimum = _elementwise(2, V, _smaller)
neg = _elementwise(1, V, lambda b, x: b.fneg(x))
absolute = _elementwise(1, V, lambda b, x: _call(b, "llvm.fabs.v16f32", _vector, [x]))
greater_equal = _elementwise(2, M, lambda b, x, y: b.fcmp_ordered(">=", x, y))
greater = _elementwise(2, M, lambda b, x, y: b.fcmp_ordered(">", x, y))
both = _elementwise(2, M, lambda b, x, y: b.and_(x, y), M)
but_not = _elementwise(2, M, lambda b, x, y: b.and_(x, b.not_(y)), M)
select = _elementwise(3, V, lambda b, m, x, y: b.select(m, x, y), M)  # m ? x : y

for _operator, _instruction in (
    (operator.add, "fadd"),
    (operator.sub, "fsub"),
    (operator.mul, "fmul"),
    (operator.truediv, "fdiv"),
):
    _binary = _elementwise(2, V, lambda b, x, y, name=_instruction: getattr(b, name)(x, y))

    # numba wants the same argument list, annotations included, in both of these
    def _bind(binary: Any) -> Any:
        def typed(x, y):  # type: ignore[no-untyped-def]
            if isinstance(x, _VectorType) and isinstance(y, _VectorType):
                return lambda x, y: binary(x, y)
            return None

        return typed

    overload(_operator)(_bind(_binary))


@intrinsic
def splat(typing_context, x):  # type: ignore[no-untyped-def]
    """All lanes = the float32 scalar x (anything else is refused, so that nothing widens)."""
    if x != types.float32:
        return None

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        undefined = ir.Constant(_vector, ir.Undefined)
        one = builder.insert_element(undefined, values[0], ir.Constant(_i32, 0))
        return builder.shuffle_vector(one, undefined, ir.Constant(_ints, [0] * LANES))

    return V(types.float32), generate


@intrinsic
def iota(typing_context):  # type: ignore[no-untyped-def]
    """0, 1, ..., 15."""
    lanes = ir.Constant(_vector, [ir.Constant(_f32, float(i)) for i in range(LANES)])
    return V(), lambda context, builder, signature, values: lanes


@intrinsic
def zeros(typing_context):  # type: ignore[no-untyped-def]
    """All lanes 0."""
    return V(), lambda context, builder, signature, values: _constant(0.0)


def _address(context: Any, builder: Any, array_type: Any, array: Any, index: Any) -> Any:
    data = make_array(array_type)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [index]), _vector.as_pointer())


@intrinsic
def load(typing_context, array, index):  # type: ignore[no-untyped-def]
    """Sixteen consecutive elements of a flat float32 array, from `index`; unchecked."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        value = builder.load(_address(context, builder, signature.args[0], values[0], values[1]))
        value.align = 4
        return value

    return V(array, types.intp), generate


@intrinsic
def store(typing_context, array, index, value):  # type: ignore[no-untyped-def]
    """Write sixteen consecutive elements of a flat float32 array, from `index`; unchecked."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        address = _address(context, builder, signature.args[0], values[0], values[1])
        builder.store(values[2], address).align = 4
        return context.get_dummy_value()

    return types.void(array, types.intp, V), generate


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
        return builder.cttz(values[0], ir.Constant(_i1, 1))

    return types.int64(types.int64), generate


@intrinsic
def prefetch(typing_context, array, index):  # type: ignore[no-untyped-def]
    """Ask for the cache line of array[index] (flat float32); never faults."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        address = _address(context, builder, signature.args[0], values[0], values[1])
        pointer = builder.bitcast(address, ir.IntType(8).as_pointer())
        hint = [ir.Constant(_i32, flag) for flag in (0, 3, 1)]  # read, keep, data
        kinds = [pointer.type, _i32, _i32, _i32]
        function = cgutils.get_or_insert_function(
            builder.module, ir.FunctionType(ir.VoidType(), kinds), "llvm.prefetch.p0"
        )
        builder.call(function, [pointer, *hint])
        return context.get_dummy_value()

    return types.void(array, types.intp), generate


# Polynomial of 2^f on [-1/2, 1/2], highest power first: least squares in float64, reweighted to the
# smallest maximal relative error; 1.6e-7 in float32.
_EXP2 = (0.00132647005, 0.00967151485, 0.0555073395, 0.240222424, 0.693147004, 1.0)


def _exp2(builder: Any, x: Any) -> Any:
    bounded = builder.select(builder.fcmp_ordered(">", x, _constant(-100)), x, _constant(-100))
    whole = _call(builder, "llvm.rint.v16f32", _vector, [bounded])
    fraction = builder.fsub(bounded, whole)
    power = _constant(_EXP2[0])
    for coefficient in _EXP2[1:]:
        power = _fma(builder, power, fraction, _constant(coefficient))
    shift = ir.Constant(_ints, [ir.Constant(_i32, 23)] * LANES)
    exponent = builder.shl(builder.fptosi(whole, _ints), shift)
    return builder.bitcast(builder.add(builder.bitcast(power, _ints), exponent), _vector)


exp2 = _elementwise(1, V, _exp2)  # for x < 127; x below -100 gives 2^-100


def _fold(builder: Any, x: Any, y: Any, group: int) -> Any:
    """Halve every group of `group` lanes by adding its two halves; x's groups, then y's."""
    half = group // 2
    low = [g * group + i for g in range(2 * LANES // group) for i in range(half)]
    low_mask = ir.Constant(_ints, [ir.Constant(_i32, i) for i in low])
    high_mask = ir.Constant(_ints, [ir.Constant(_i32, i + half) for i in low])
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
                level = [*level, _constant(0.0)]
            level = [_fold(builder, level[i], level[i + 1], group) for i in range(0, len(level), 2)]
            group //= 2
        return level[0]

    return V(vectors), generate
