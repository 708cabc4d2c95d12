"""What framework and plugins log during a run reaches the user's screen and the run's record.

Library code only logs (`logging.getLogger(__name__)`) and does not depend on `Progress`; without a
handler Python would drop its INFO records.
"""

import logging
from collections.abc import Iterator
from contextlib import contextmanager

from framework.errors import printable_line
from framework.records.progress import Progress

LOGGERS = ("framework", "plugins")  # the parents of every module's logger
QUIET = "warm-up"  # a thread of that name is at something the user did not ask for


class _Notes(logging.Handler):
    """Passes every record of at least INFO to `progress.note`, as one line."""

    def __init__(self, progress: Progress) -> None:
        super().__init__(logging.INFO)
        self._progress = progress

    def emit(self, record: logging.LogRecord) -> None:
        if record.threadName == QUIET:
            return
        text = " ".join(record.getMessage().split())
        if getattr(record, "passing", False):  # the next such line may replace it
            self._progress.stage(text)
            return
        warns = record.levelno >= logging.WARNING
        self._progress.note(f"{record.levelname.lower()}: {text}" if warns else text)


class _Warnings(logging.Handler):
    """Appends the text of every warning to `texts`."""

    def __init__(self, texts: list[str]) -> None:
        super().__init__(logging.WARNING)
        self._texts = texts

    def emit(self, record: logging.LogRecord) -> None:
        if record.threadName != QUIET:
            self._texts.append(printable_line(" ".join(record.getMessage().split())))


@contextmanager
def noted(progress: Progress) -> Iterator[None]:
    """Show on `progress` what framework and plugins log at INFO and above.

    Afterwards the loggers are as they were, so that runs of one process do not add up.
    """
    with _handling(_Notes(progress)):
        yield


@contextmanager
def warnings_of() -> Iterator[list[str]]:
    """Yield the list that the warnings of framework and plugins are appended to, one line each."""
    texts: list[str] = []
    with _handling(_Warnings(texts)):
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
