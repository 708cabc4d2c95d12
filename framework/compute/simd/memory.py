"""Lanes from and to flat arrays: in a row, as items of several floats, transposed, as integers."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.np.arrayobj import make_array

from framework.compute.simd.vector import I32, INTS, LANES, VECTOR, V, intrinsic


def address_of(context: Any, builder: Any, array_type: Any, array: Any, index: Any) -> Any:
    data = make_array(array_type)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [index]), VECTOR.as_pointer())


@intrinsic
def load(typing_context, array, index):  # type: ignore[no-untyped-def]
    """Sixteen consecutive elements of a flat float32 array, from `index`; unchecked."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        value = builder.load(address_of(context, builder, signature.args[0], values[0], values[1]))
        value.align = 4
        return value

    return V(array, types.intp), generate


@intrinsic
def store(typing_context, array, index, value):  # type: ignore[no-untyped-def]
    """Write sixteen consecutive elements of a flat float32 array, from `index`; unchecked."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        address = address_of(context, builder, signature.args[0], values[0], values[1])
        builder.store(values[2], address).align = 4
        return context.get_dummy_value()

    return types.void(array, types.intp, V), generate


def _interleaved(width: int) -> Any:
    """Sixteen items of `width` floats from a flat float32 array, as a tuple of `width` vectors."""

    @intrinsic
    def load_items(typing_context, array, index):  # type: ignore[no-untyped-def]
        signature = types.UniTuple(V, width)(array, types.intp)

        def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            parts = []
            for k in range(width):
                at = builder.add(values[1], values[1].type(16 * k))
                part = builder.load(address_of(context, builder, signature.args[0], values[0], at))
                part.align = 4
                parts.append(part)
            columns = [
                _pick(builder, parts, [i * width + k for i in range(LANES)]) for k in range(width)
            ]
            return context.make_tuple(builder, signature.return_type, columns)

        return signature, generate

    return load_items


def _spread(width: int) -> Any:
    """The inverse of `_interleaved`: store a tuple of `width` vectors as sixteen items."""

    @intrinsic
    def store_items(typing_context, array, index, columns):  # type: ignore[no-untyped-def]
        def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            columns = cgutils.unpack_tuple(builder, values[2])
            for k in range(width):
                order = [16 * k + i for i in range(LANES)]
                part = _pick(builder, columns, [n % width * LANES + n // width for n in order])
                at = builder.add(values[1], values[1].type(16 * k))
                address = address_of(context, builder, signature.args[0], values[0], at)
                builder.store(part, address).align = 4
            return context.get_dummy_value()

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
def load16(typing_context, array, index):  # type: ignore[no-untyped-def]
    """Sixteen rows of 16 floats from a flat float32 array, as the tuple of their 16 columns."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        rows = []
        for k in range(LANES):
            at = builder.add(values[1], values[1].type(LANES * k))
            row = builder.load(address_of(context, builder, signature.args[0], values[0], at))
            row.align = 4
            rows.append(row)
        columns = _transposed(builder, rows)
        return context.make_tuple(builder, signature.return_type, columns)

    return types.UniTuple(V, LANES)(array, types.intp), generate


@intrinsic
def store16(typing_context, array, index, columns):  # type: ignore[no-untyped-def]
    """The inverse of `load16`."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        rows = _transposed(builder, cgutils.unpack_tuple(builder, values[2]))
        for k, row in enumerate(rows):
            at = builder.add(values[1], values[1].type(LANES * k))
            address = address_of(context, builder, signature.args[0], values[0], at)
            builder.store(row, address).align = 4
        return context.get_dummy_value()

    return types.void(array, types.intp, types.UniTuple(V, LANES)), generate


@intrinsic
def store_whole(typing_context, array, index, value):  # type: ignore[no-untyped-def]
    """Write the lanes, whole numbers, into sixteen elements of a flat integer array."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        kind = ir.VectorType(ir.IntType(signature.args[0].dtype.bitwidth), LANES)
        data = make_array(signature.args[0])(context, builder, values[0]).data
        address = builder.bitcast(builder.gep(data, [values[1]]), kind.as_pointer())
        builder.store(builder.fptosi(values[2], kind), address).align = 1
        return context.get_dummy_value()

    return types.void(array, types.intp, V), generate


@intrinsic
def prefetch(typing_context, array, index):  # type: ignore[no-untyped-def]
    """Prefetch the cache line of array[index] (flat, of four bytes each); never faults."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        address = address_of(context, builder, signature.args[0], values[0], values[1])
        pointer = builder.bitcast(address, ir.IntType(8).as_pointer())
        hint = [ir.Constant(I32, flag) for flag in (0, 3, 1)]  # read, keep, data
        kinds = [pointer.type, I32, I32, I32]
        function = cgutils.get_or_insert_function(
            builder.module, ir.FunctionType(ir.VoidType(), kinds), "llvm.prefetch.p0"
        )
        builder.call(function, [pointer, *hint])
        return context.get_dummy_value()

    return types.void(array, types.intp), generate
