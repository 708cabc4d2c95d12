"""What `run_blocks` gives every block, `run_tasks` and `run_together` every task."""

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator

import pytest

from framework.compute.parallel import (
    Abandoned,
    in_task,
    run_blocks,
    run_tasks,
    run_together,
    set_threads,
)


@pytest.fixture(params=[1, 3])
def threads(request: pytest.FixtureRequest) -> Iterator[int]:
    set_threads(request.param)
    yield request.param
    set_threads(0)


def test_every_block_runs_once_and_no_two_threads_share_what_is_their_own(threads: int) -> None:
    ours: list[tuple[set[int]]] = [(set(),) for _ in range(threads)]
    seen: list[int] = []

    def kernel(block: int, blocks: int, mine: set[int], word: str) -> None:
        assert (blocks, word) == (40, "word")
        mine.add(threading.get_ident())
        seen.append(block)

    run_blocks(kernel, "word", blocks=40, scratch=ours)
    assert sorted(seen) == list(range(40))
    assert all(len(mine) <= 1 for (mine,) in ours)


def test_threads_help_each_other() -> None:
    """The first block ends when all others are done, also those of the same thread's range."""
    set_threads(2)
    others, all_done = set(range(1, 8)), threading.Event()

    def kernel(block: int, blocks: int) -> None:
        if block == 0:
            assert all_done.wait(20)
            return
        others.discard(block)
        if not others:
            all_done.set()

    try:
        run_blocks(kernel, blocks=8)
    finally:
        set_threads(0)
    assert not others


def test_a_forked_process_has_threads_of_its_own(threads: int) -> None:
    """Its parent's do not exist there: who waited for them would wait for ever."""
    run_blocks(lambda block, blocks: None)
    child = os.fork()
    if child == 0:
        seen: list[int] = []
        try:  # whatever happens, pytest may not go on here
            signal.alarm(20)
            run_blocks(lambda block, blocks: seen.append(block), blocks=40)
        finally:
            os._exit(0 if sorted(seen) == list(range(40)) else 1)
    assert os.waitpid(child, 0)[1] == 0


def test_threads_of_several_callers(threads: int) -> None:
    """Each call ends when its own blocks are done, whoever else uses the pool, also the first."""
    counts, go = [0] * 8, threading.Barrier(8)

    def calls(caller: int) -> None:
        def kernel(block: int, blocks: int, mine: list[int]) -> None:
            time.sleep(0.0005)
            mine.append(block)

        go.wait(20)
        for _ in range(10):
            seen: list[int] = []
            run_blocks(kernel, seen, blocks=10)
            counts[caller] += len(seen)

    set_threads(threads + 3)
    callers = [threading.Thread(target=calls, args=(caller,)) for caller in range(8)]
    for caller in callers:
        caller.start()
    for caller in callers:
        caller.join(20)
    assert counts == [100] * 8


def test_tasks_give_their_results_in_order(threads: int) -> None:
    assert run_tasks([lambda i=i: i * i for i in range(7)]) == [0, 1, 4, 9, 16, 25, 36]  # type: ignore[misc]
    assert run_tasks([]) == []

    def fails() -> None:
        raise ValueError("a task")

    with pytest.raises(ValueError, match="a task"):
        run_tasks([fails, lambda: 1])


def test_together_the_first_to_fail_ends_all() -> None:
    """An error and an interrupt alike; what the others were at is abandoned at their next check."""
    both, abandoned = threading.Barrier(2), list[int]()

    def fails(check: Callable[[], None]) -> None:
        both.wait(10)
        raise KeyboardInterrupt

    def works(check: Callable[[], None]) -> None:
        both.wait(10)
        try:
            while True:
                time.sleep(0.001)
                check()
        except Abandoned:
            abandoned.append(1)
            raise

    for tasks in ([fails, works], [works, fails]):
        with pytest.raises(KeyboardInterrupt):
            run_together(tasks)
    assert abandoned == [1, 1]


def test_an_interrupt_while_others_are_at_work_ends_them_first() -> None:
    """The caller waits for them: they may be writing into a folder it gives back."""
    ended = list[int]()

    def works(check: Callable[[], None]) -> None:
        signal.raise_signal(signal.SIGINT)
        try:
            for _ in range(100):
                time.sleep(0.05)
                check()
        finally:
            ended.append(1)

    # a shell's background job ignores it
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            run_together([lambda check: None, works])
    finally:
        signal.signal(signal.SIGINT, before)
    assert ended == [1]


def test_together_one_alone_has_all_threads(threads: int) -> None:
    assert run_together([lambda check: in_task()]) == [False]
    assert run_together([lambda check: in_task()] * 2) == [True, True]
