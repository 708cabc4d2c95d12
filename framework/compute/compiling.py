"""Notice when a kernel is really compiled, as one that the cache on disk has is only loaded."""

import contextlib
import time
from collections.abc import Callable, Iterator
from typing import Any

from numba.core import event

COMPILE = "numba:compile"


class Compilations(event.Listener):  # type: ignore[misc]  # numba has no types
    """Kernels compiled, and wall seconds from the start of the first to the end of the last one.

    Args:
        on_first: called once, as the first begins.
    """

    def __init__(self, on_first: Callable[[], None]) -> None:
        self._on_first = on_first
        self._began: float | None = None
        self.kernels, self.seconds = 0, 0.0

    def on_start(self, _: Any) -> None:
        if self._began is None:
            self._began = time.perf_counter()
            self._on_first()

    def on_end(self, _: Any) -> None:
        assert self._began is not None, "an end without a start"
        self.kernels += 1
        self.seconds = time.perf_counter() - self._began


@contextlib.contextmanager
def noticed(on_first: Callable[[], None]) -> Iterator[Compilations]:
    """Count what any thread of this process compiles inside."""
    with event.install_listener(COMPILE, Compilations(on_first)) as listener:
        yield listener
