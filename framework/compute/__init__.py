"""How kernels run: compiled (`jit`), on vectors (`simd`, `chunks`), on threads (`parallel`), with
draws of their own (`rng`), on the clock (`stopwatch`), no longer than who asked (`orphans`)."""

__all__ = ["chunks", "jit", "orphans", "parallel", "rng", "simd", "stopwatch"]
