"""How kernels run: compiled (`jit`; `compiling` notices it), on vectors (`simd`, `chunks`), on
threads (`parallel`), with draws of their own (`rng`), on the clock (`stopwatch`), no longer than
who asked (`orphans`)."""

__all__ = ["chunks", "compiling", "jit", "orphans", "parallel", "rng", "simd", "stopwatch"]
