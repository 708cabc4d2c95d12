"""How kernels run.

`jit`: compilation; `compiling`: its detection; `simd`, `chunks`: vectors; `parallel`: threads;
`rng`: random streams; `stopwatch`: times; `orphans`: the end with the parent process. `portable`
and `tensors`: arithmetic with the same bits on every processor.
"""
