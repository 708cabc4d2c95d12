"""Sixteen float32 lanes as a value inside numba kernels.

LLVM's auto-vectoriser gives up on the blending loops (branches, masks, many accumulators); an
explicit vector type does not depend on it. LLVM lowers it to one AVX-512, two AVX2 or four
SSE/NEON registers. Every operation is strict IEEE and every sum has a fixed order, so results have
the same bits on each of them.
"""

import math
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

F32, I32, I1 = ir.FloatType(), ir.IntType(32), ir.IntType(1)
VECTOR = ir.VectorType(F32, LANES)
INTS = ir.VectorType(I32, LANES)
MASK = ir.VectorType(I1, LANES)


class VectorType(types.Type):
    def __init__(self) -> None:
        super().__init__(name="float32x16")


class _MaskType(types.Type):
    def __init__(self) -> None:
        super().__init__(name="mask16")


V, M = VectorType(), _MaskType()


@register_model(VectorType)
class _VectorModel(models.PrimitiveModel):
    def __init__(self, dmm: Any, fe_type: Any) -> None:
        super().__init__(dmm, fe_type, VECTOR)


@register_model(_MaskType)
class _MaskModel(models.PrimitiveModel):
    def __init__(self, dmm: Any, fe_type: Any) -> None:
        super().__init__(dmm, fe_type, MASK)


def constant(value: float) -> ir.Constant:
    return ir.Constant(VECTOR, [ir.Constant(F32, float(np.float32(value)))] * LANES)


def call(builder: Any, name: str, result: Any, arguments: list[Any]) -> Any:
    signature = ir.FunctionType(result, [a.type for a in arguments])
    return builder.call(cgutils.get_or_insert_function(builder.module, signature, name), arguments)


def elementwise(arity: int, result: Any, build: Any, first: Any = V) -> Any:
    """An intrinsic of `arity` vectors; `build(builder, *values)` emits the instructions."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return build(builder, *values)

    if arity == 1:

        @intrinsic
        def unary(typing_context, x):
            return result(first), generate

        return unary
    if arity == 2:

        @intrinsic
        def binary(typing_context, x, y):
            return result(first, first), generate

        return binary

    @intrinsic
    def ternary(typing_context, x, y, z):
        return result(first, V, V), generate

    return ternary


# Arithmetic: operators, comparisons, masks and constants.


def _fused(builder: Any, x: Any, y: Any, z: Any) -> Any:
    return call(builder, "llvm.fma.v16f32", VECTOR, [x, y, z])


def _smaller(builder: Any, x: Any, y: Any) -> Any:
    return builder.select(builder.fcmp_ordered("<", x, y), x, y)


fma = elementwise(3, V, _fused)  # x * y + z, rounded once
fnma = elementwise(3, V, lambda b, x, y, z: _fused(b, b.fneg(x), y, z))  # z - x * y
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
        def typed(x, y):
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
def _negative(x):
    return (lambda x: neg(x)) if isinstance(x, VectorType) else None


_root = elementwise(1, V, lambda b, x: call(b, "llvm.sqrt.v16f32", VECTOR, [x]))


@overload(math.sqrt)
def _square_root(x):
    return (lambda x: _root(x)) if isinstance(x, VectorType) else None


@intrinsic
def splat(typing_context, x):
    """All lanes = the float32 scalar x (anything else is refused, so that nothing widens)."""
    if x != types.float32:
        return None

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        undefined = ir.Constant(VECTOR, ir.Undefined)
        one = builder.insert_element(undefined, values[0], ir.Constant(I32, 0))
        return builder.shuffle_vector(one, undefined, ir.Constant(INTS, [0] * LANES))

    return V(types.float32), generate


@intrinsic
def iota(typing_context):
    """0, 1, ..., 15."""
    lanes = ir.Constant(VECTOR, [ir.Constant(F32, float(i)) for i in range(LANES)])
    return V(), lambda context, builder, signature, values: lanes


@intrinsic
def zeros(typing_context):
    """All lanes 0."""
    return V(), lambda context, builder, signature, values: constant(0.0)


@intrinsic
def any_lane(typing_context, mask):
    """True if a lane of the mask is set."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        bits = ir.IntType(LANES)
        return builder.icmp_unsigned("!=", builder.bitcast(values[0], bits), ir.Constant(bits, 0))

    return types.boolean(M), generate


@intrinsic
def lowest_bit(typing_context, bits):
    """Index of the lowest set bit of an int64 that is not 0."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return builder.cttz(values[0], ir.Constant(I1, 1))

    return types.int64(types.int64), generate


# Functions: powers and logarithms to base 2, and sums over the lanes.

# Polynomial of 2^f on [-1/2, 1/2], highest power first: least squares in float64, reweighted to the
# smallest maximal relative error; 1.6e-7 in float32.
_EXP2 = (0.00132647005, 0.00967151485, 0.0555073395, 0.240222424, 0.693147004, 1.0)


def _exp2(builder: Any, x: Any) -> Any:
    bounded = builder.select(builder.fcmp_ordered(">", x, constant(-125)), x, constant(-125))
    whole = call(builder, "llvm.rint.v16f32", VECTOR, [bounded])
    fraction = builder.fsub(bounded, whole)
    power = constant(_EXP2[0])
    for coefficient in _EXP2[1:]:
        power = _fused(builder, power, fraction, constant(coefficient))
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
        series = _fused(builder, series, square, constant(coefficient))
    return _fused(builder, s, series, builder.sitofp(exponent, VECTOR))


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
def lane_sums(typing_context, vectors):
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


# Lanes from and to flat arrays: in a row, as items of several floats, transposed, as integers.


def _address(context: Any, builder: Any, array_type: Any, array: Any, index: Any) -> Any:
    data = make_array(array_type)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [index]), VECTOR.as_pointer())


def _read(context: Any, builder: Any, signature: Any, values: Any, k: int) -> Any:
    """The k-th vector of the array values[0] from the index values[1] on."""
    at = builder.add(values[1], values[1].type(LANES * k))
    vector = builder.load(_address(context, builder, signature.args[0], values[0], at))
    vector.align = 4
    return vector


def _write(context: Any, builder: Any, signature: Any, values: Any, vectors: list[Any]) -> Any:
    """Put vectors into the array values[0], from the index values[1] on."""
    for k, vector in enumerate(vectors):
        at = builder.add(values[1], values[1].type(LANES * k))
        address = _address(context, builder, signature.args[0], values[0], at)
        builder.store(vector, address).align = 4
    return context.get_dummy_value()


@intrinsic
def load(typing_context, array, index):
    """Sixteen consecutive elements of a flat float32 array, from `index`; unchecked."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return _read(context, builder, signature, values, 0)

    return V(array, types.intp), generate


@intrinsic
def store(typing_context, array, index, value):
    """Write sixteen consecutive elements of a flat float32 array, from `index`; unchecked."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return _write(context, builder, signature, values, [values[2]])

    return types.void(array, types.intp, V), generate


def _interleaved(width: int) -> Any:
    """Sixteen items of `width` floats from a flat float32 array, as a tuple of `width` vectors."""

    @intrinsic
    def load_items(typing_context, array, index):
        signature = types.UniTuple(V, width)(array, types.intp)

        def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            parts = [_read(context, builder, signature, values, k) for k in range(width)]
            columns = [
                _pick(builder, parts, [i * width + k for i in range(LANES)]) for k in range(width)
            ]
            return context.make_tuple(builder, signature.return_type, columns)

        return signature, generate

    return load_items


def _spread(width: int) -> Any:
    """The inverse of `_interleaved`: store a tuple of `width` vectors as sixteen items."""

    @intrinsic
    def store_items(typing_context, array, index, columns):
        def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            columns = cgutils.unpack_tuple(builder, values[2])
            order = [n % width * LANES + n // width for n in range(width * LANES)]
            rows = [order[k * LANES : (k + 1) * LANES] for k in range(width)]
            parts = [_pick(builder, columns, row) for row in rows]
            return _write(context, builder, signature, values, parts)

        return types.void(array, types.intp, types.UniTuple(V, width)), generate

    return store_items


def _pick(builder: Any, parts: list[Any], order: list[int]) -> Any:
    """The vector whose lane i is element order[i] of the concatenated parts."""
    result = ir.Constant(VECTOR, ir.Undefined)
    for k, part in enumerate(parts):
        # lanes that lie in this part come from it (16 + lane of the part), the others stay
        lanes = [LANES + n % LANES if n // LANES == k else i for i, n in enumerate(order)]
        mask = ir.Constant(INTS, [ir.Constant(I32, lane) for lane in lanes])
        result = builder.shuffle_vector(result, part, mask)
    return result


load2, load3, load4 = _interleaved(2), _interleaved(3), _interleaved(4)
store2, store3, store4 = _spread(2), _spread(3), _spread(4)


def _transposed(builder: Any, rows: list[Any]) -> list[Any]:
    """The 16x16 transpose of sixteen vectors: four rounds that exchange halves."""
    step = 1
    while step < LANES:
        low = [i if i & step == 0 else LANES + (i ^ step) for i in range(LANES)]
        high = [i ^ step if i & step == 0 else LANES + i for i in range(LANES)]
        masks = [ir.Constant(INTS, [ir.Constant(I32, i) for i in m]) for m in (low, high)]
        done = list(rows)
        for i in range(LANES):
            if i & step == 0:
                pair = rows[i], rows[i + step]
                done[i] = builder.shuffle_vector(*pair, masks[0])
                done[i + step] = builder.shuffle_vector(*pair, masks[1])
        rows, step = done, 2 * step
    return rows


@intrinsic
def load16(typing_context, array, index):
    """Sixteen rows of 16 floats from a flat float32 array, as the tuple of their 16 columns."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        rows = [_read(context, builder, signature, values, k) for k in range(LANES)]
        columns = _transposed(builder, rows)
        return context.make_tuple(builder, signature.return_type, columns)

    return types.UniTuple(V, LANES)(array, types.intp), generate


@intrinsic
def store16(typing_context, array, index, columns):
    """The inverse of `load16`."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        rows = _transposed(builder, cgutils.unpack_tuple(builder, values[2]))
        return _write(context, builder, signature, values, rows)

    return types.void(array, types.intp, types.UniTuple(V, LANES)), generate


@intrinsic
def store_whole(typing_context, array, index, value):
    """Write the lanes, whole numbers, into sixteen elements of a flat integer array."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        kind = ir.VectorType(ir.IntType(signature.args[0].dtype.bitwidth), LANES)
        data = make_array(signature.args[0])(context, builder, values[0]).data
        address = builder.bitcast(builder.gep(data, [values[1]]), kind.as_pointer())
        builder.store(builder.fptosi(values[2], kind), address).align = 1
        return context.get_dummy_value()

    return types.void(array, types.intp, V), generate


@intrinsic
def prefetch(typing_context, array, index):
    """Prefetch the cache line of array[index] (flat, of four bytes each); never faults."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        address = _address(context, builder, signature.args[0], values[0], values[1])
        pointer = builder.bitcast(address, ir.IntType(8).as_pointer())
        hint = [ir.Constant(I32, flag) for flag in (0, 3, 1)]  # read, keep, data
        kinds = [pointer.type, I32, I32, I32]
        function = cgutils.get_or_insert_function(
            builder.module, ir.FunctionType(ir.VoidType(), kinds), "llvm.prefetch.p0"
        )
        builder.call(function, [pointer, *hint])
        return context.get_dummy_value()

    return types.void(array, types.intp), generate
