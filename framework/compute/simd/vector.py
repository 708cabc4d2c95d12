"""The types of sixteen float32 lanes and of their masks, as numba and LLVM know them."""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic as numba_intrinsic
from numba.extending import models, register_model

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
