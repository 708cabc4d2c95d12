"""What the framework logs while a run goes on becomes notes on the user's screen.

Library code only logs (`logging.getLogger(__name__)`) and knows no `Progress`; without a handler
Python would drop its INFO records unseen.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager

from framework.progress import Progress

LOGGER = "framework"  # the parent of every module's logger


class _Notes(logging.Handler):
    """Hands every record of at least INFO to `progress.note`, in one line."""

    def __init__(self, progress: Progress) -> None:
        super().__init__(logging.INFO)
        self._progress = progress

    def emit(self, record: logging.LogRecord) -> None:
        text = " ".join(record.getMessage().split())
        warns = record.levelno >= logging.WARNING
        self._progress.note(f"{record.levelname.lower()}: {text}" if warns else text)


@contextmanager
def noted(progress: Progress) -> Iterator[None]:
    """While it lasts, `progress.note` tells what the framework logs at INFO and above.

    Afterwards the logger is as it was, so that runs of one process do not add up.
    """
    logger, handler = logging.getLogger(LOGGER), _Notes(progress)
    level = logger.level
    logger.addHandler(handler)
    if not logger.isEnabledFor(logging.INFO):
        logger.setLevel(logging.INFO)
    try:
        yield
    finally:
        logger.setLevel(level)
        logger.removeHandler(handler)
