"""How kernels run: compiled (`jit`; `compiling` notices it), on vectors (`simd`, `chunks`), on
threads (`parallel`), with draws of their own (`rng`), on the clock (`stopwatch`), no longer than
who asked (`orphans`); and arithmetic that is the same bits on every processor (`portable`,
of tensors `tensors`)."""

__all__ = [
    "chunks",
    "compiling",
    "jit",
    "orphans",
    "parallel",
    "portable",
    "rng",
    "simd",
    "stopwatch",
    "tensors",
]
