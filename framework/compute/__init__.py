"""How kernels run: compiled (`jit`), on vectors (`simd`, `chunks`), on threads (`parallel`), with
draws of their own (`rng`) and on the clock (`stopwatch`)."""

__all__ = ["chunks", "jit", "parallel", "rng", "simd", "stopwatch"]
