"""What framework and plugins log during a run reaches the user's screen and the run's record.

Library code only logs (`logging.getLogger(__name__)`) and does not depend on `Progress`; without a
handler Python would drop its INFO records.
"""

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from framework.errors import printable_line
from framework.records.progress import Progress

LOGGERS = ("framework", "plugins")  # the parents of every module's logger
QUIET = "warm-up"  # a thread of that name works in the background


class _Lines(logging.Handler):
    """Passes every record from `level` on, as one line."""

    def __init__(self, level: int, receive: Callable[[logging.LogRecord, str], None]) -> None:
        super().__init__(level)
        self._receive = receive

    def emit(self, record: logging.LogRecord) -> None:
        if record.threadName != QUIET:
            self._receive(record, " ".join(record.getMessage().split()))


@contextmanager
def noted(progress: Progress) -> Iterator[None]:
    """Show on `progress` what framework and plugins log at INFO and above.

    Afterwards the loggers are as they were, so that runs of one process do not add up.
    """

    def show(record: logging.LogRecord, text: str) -> None:
        if getattr(record, "passing", False):  # the next such line may replace it
            progress.stage(text)
        elif record.levelno >= logging.WARNING:
            progress.note(f"{record.levelname.lower()}: {text}")
        else:
            progress.note(text)

    with _handling(_Lines(logging.INFO, show)):
        yield


@contextmanager
def warnings_of() -> Iterator[list[str]]:
    """Yield the list that the warnings of framework and plugins are appended to, one line each."""
    texts: list[str] = []

    def add(_: logging.LogRecord, text: str) -> None:
        texts.append(printable_line(text))

    with _handling(_Lines(logging.WARNING, add)):
        yield texts


@contextmanager
def _handling(handler: logging.Handler) -> Iterator[None]:
    before = [(logger, logger.level) for logger in map(logging.getLogger, LOGGERS)]
    for logger, _ in before:
        logger.addHandler(handler)
        if not logger.isEnabledFor(handler.level):
            logger.setLevel(handler.level)
    try:
        yield
    finally:
        for logger, level in before:
            logger.setLevel(level)
            logger.removeHandler(handler)
