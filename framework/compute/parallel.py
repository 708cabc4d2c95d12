"""The project's own thread pool for `nogil` kernels.

numba's threading layers abort, duplicate OpenMP or kill forked children, so kernels here are plain
functions over a block `(index, n_blocks)` that a small pool calls. Every block writes only its own
outputs, hence results do not depend on the number of threads.
"""

import functools
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from queue import SimpleQueue
from typing import Any

BLOCKS = 16  # blocks per parallel call, fixed, so that no result can depend on the thread count

WAKE_S = 0.1  # a signal that another thread got does not wake one that waits for ever

_threads = 0
_local = threading.local()  # in_task: this thread is at a task of `run_tasks`


class Abandoned(Exception):
    """Another of the tasks that run together failed; this one's result is not needed."""


def set_threads(n: int) -> None:
    """Use `n` threads for kernels; 0 = all cores this process may run on now."""
    global _threads
    if n < 0:
        raise ValueError(f"set_threads: expected 0 or more, got {n}")
    _threads = int(n) or _cores()


def threads() -> int:
    """The number of threads in use."""
    return _threads or _cores()


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def run_blocks(
    kernel: Callable[..., Any],
    *args: Any,
    blocks: int = BLOCKS,
    scratch: Sequence[tuple[Any, ...]] = (),
) -> None:
    """Call `kernel(block, blocks, *scratch[thread], *args)` for every block, and wait for all.

    Every thread, including the caller, has a range of blocks, as neighbours share cache lines. Then
    it helps others with theirs. Raises whatever a block raised.

    Args:
        scratch: arguments for each thread, whose content is lost after a block. They limit the
            number of threads; without them the kernel gets none.
    """
    pool = threads()
    n = min(pool, len(scratch)) if scratch else pool
    scratch = scratch or ((),) * n
    # a task may not wait for the pool, whose threads may be at other tasks
    if n == 1 or in_task():
        for block in range(blocks):
            kernel(block, blocks, *scratch[0], *args)
        return
    # a block is taken once, as a range iterator's next() is atomic (under the GIL)
    shares = [iter(range(blocks * thread // n, blocks * (thread + 1) // n)) for thread in range(n)]

    def work(thread: int) -> None:
        for share in shares[thread:] + shares[:thread]:
            for block in share:
                kernel(block, blocks, *scratch[thread], *args)

    ended: SimpleQueue[BaseException | None] = SimpleQueue()

    def help_with(thread: int) -> None:
        try:
            work(thread)
        except BaseException as error:
            ended.put(error)
        else:
            ended.put(None)

    jobs = _helpers(os.getpid(), pool - 1)
    for thread in range(1, n):
        jobs.put(functools.partial(help_with, thread))
    try:
        work(0)
    finally:  # no thread may write when the caller's buffers are reused
        failed = [ended.get() for _ in range(1, n)]
    for error in failed:
        if error is not None:
            raise error


def run_tasks(tasks: Sequence[Callable[[], Any]]) -> list[Any]:
    """Run `tasks` on as many threads as kernels have, and return their results in order.

    For work in libraries that leave the interpreter free. What a task runs by `run_blocks` runs on
    its own thread.
    """
    results: list[Any] = [None] * len(tasks)

    def run(index: int, _: int) -> None:
        with alone():
            results[index] = tasks[index]()

    run_blocks(run, blocks=len(tasks))
    return results


def run_together(tasks: Sequence[Callable[[Callable[[], None]], Any]]) -> list[Any]:
    """Run long `tasks`, each on one thread, and return their results in order.

    A single task gets all threads. Each task receives a function that it calls regularly; it raises
    Abandoned once another task has failed or the caller was interrupted. When all tasks have
    ended, the first failure is raised.
    """
    results: list[Any] = [None] * len(tasks)
    failed: list[BaseException] = []

    def check() -> None:
        if failed:
            raise Abandoned

    def work(index: int) -> None:
        try:
            with alone():
                results[index] = tasks[index](check)
        except BaseException as error:
            failed.append(error)
        finally:
            ended[index].set()

    if len(tasks) == 1:
        return [tasks[0](check)]
    # events, as an interrupted Thread.join takes the thread for ended (CPython 3.11)
    ended = [threading.Event() for _ in tasks]
    others = [threading.Thread(target=work, args=(index,)) for index in range(1, len(tasks))]
    try:
        for thread in others:
            thread.start()
        work(0)
        _wait(ended)
    except BaseException as error:  # an interrupt outside the task, as while waiting for others
        failed.append(error)
        _wait([event for event, t in zip(ended[1:], others, strict=True) if t.ident is not None])
    if failed:
        raise failed[0]
    return results


def _wait(events: Sequence[threading.Event]) -> None:
    for event in events:
        while not event.wait(WAKE_S):
            pass


@contextmanager
def alone() -> Iterator[None]:
    """Run the blocks of `run_blocks` on the calling thread only, as in a task."""
    before, _local.in_task = in_task(), True
    try:
        yield
    finally:
        _local.in_task = before


def in_task() -> bool:
    """Whether what this thread runs has no other thread, as in a task."""
    return getattr(_local, "in_task", False)


@functools.cache
def _helpers(process: int, count: int) -> SimpleQueue[Callable[[], None]]:
    """The queue that `count` threads of this process take jobs from; a process that is forked has
    none of its parent's. Lighter than a `ThreadPoolExecutor`, several times per training step."""
    jobs: SimpleQueue[Callable[[], None]] = SimpleQueue()
    for _ in range(count):
        threading.Thread(target=_serve, args=(jobs,), name="fishersplat", daemon=True).start()
    return jobs


def _serve(jobs: SimpleQueue[Callable[[], None]]) -> None:
    while True:
        jobs.get()()
