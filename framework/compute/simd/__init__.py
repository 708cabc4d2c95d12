"""Sixteen float32 lanes as a value inside numba kernels.

LLVM's auto-vectoriser gives up on the blending loops (branches, masks, many accumulators); an
explicit vector type does not depend on it. LLVM lowers it to one AVX-512, two AVX2 or four
SSE/NEON registers. Every operation is strict IEEE and every sum has a fixed order, so results have
the same bits on each of them.
"""

from __future__ import annotations

from framework.compute.simd.arithmetic import (
    absolute,
    any_lane,
    both,
    but_not,
    ceil,
    floor,
    fma,
    fnma,
    greater,
    greater_equal,
    iota,
    lowest_bit,
    maximum,
    minimum,
    neg,
    select,
    splat,
    zeros,
)
from framework.compute.simd.functions import exp2, lane_sums, log2
from framework.compute.simd.memory import (
    load,
    load2,
    load3,
    load4,
    load16,
    prefetch,
    store,
    store2,
    store3,
    store4,
    store16,
    store_whole,
)
from framework.compute.simd.vector import LANES

__all__ = [
    "LANES",
    "absolute",
    "any_lane",
    "both",
    "but_not",
    "ceil",
    "exp2",
    "floor",
    "fma",
    "fnma",
    "greater",
    "greater_equal",
    "iota",
    "lane_sums",
    "load",
    "load2",
    "load3",
    "load4",
    "load16",
    "log2",
    "lowest_bit",
    "maximum",
    "minimum",
    "neg",
    "prefetch",
    "select",
    "splat",
    "store",
    "store2",
    "store3",
    "store4",
    "store16",
    "store_whole",
    "zeros",
]
