"""What framework and plugins log while a run goes on becomes notes on the user's screen.

Library code only logs (`logging.getLogger(__name__)`) and knows no `Progress`; without a handler
Python would drop its INFO records unseen.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager

from framework.records.progress import Progress

LOGGERS = ("framework", "plugins")  # the parents of every module's logger
QUIET = "warm-up"  # a thread of that name is at something the user did not ask for


class _Notes(logging.Handler):
    """Hands every record of at least INFO to `progress.note`, in one line."""

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


@contextmanager
def noted(progress: Progress) -> Iterator[None]:
    """While it lasts, `progress.note` tells what framework and plugins log at INFO and above.

    Afterwards the loggers are as they were, so that runs of one process do not add up.
    """
    handler = _Notes(progress)
    before = [(logger, logger.level) for logger in map(logging.getLogger, LOGGERS)]
    for logger, _ in before:
        logger.addHandler(handler)
        if not logger.isEnabledFor(logging.INFO):
            logger.setLevel(logging.INFO)
    try:
        yield
    finally:
        for logger, level in before:
            logger.setLevel(level)
            logger.removeHandler(handler)
