"""Standard streams that never end a run."""

from __future__ import annotations

import contextlib
import errno
import io
import os
import sys

from framework.records.progress import unread


def make_safe() -> None:
    """Keep a closed or full stdout or stderr, or one that cannot encode a letter, from raising."""
    with contextlib.suppress(OSError):
        while os.open(os.devnull, os.O_RDWR) <= 2:  # takes the lowest number that is free
            pass
    for name in ("stdin", "stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:  # was closed at the start
            setattr(sys, name, open(os.devnull, "r" if name == "stdin" else "w"))  # noqa: SIM115
        elif name != "stdin" and type(stream) is io.TextIOWrapper:
            lines, encoding = stream.line_buffering, stream.encoding
            lines = lines or name == "stderr"
            safe = _Safe(stream.detach(), encoding, "backslashreplace", line_buffering=lines)
            setattr(sys, name, safe)


class _Safe(io.TextIOWrapper):
    """Discards output once a disk is full, with one warning on stderr."""

    def write(self, text: str) -> int:
        try:
            written = super().write(text)
            if self.line_buffering and "\n" in text:
                super().flush()
            return written
        except OSError as error:
            return self._lost(error, len(text))

    def flush(self) -> None:
        try:
            super().flush()
        except OSError as error:
            self._lost(error, 0)

    def _lost(self, error: OSError, written: int) -> int:
        if error.errno == errno.EPIPE:  # `| head`, which callers handle
            raise error
        unread(self)
        if self is not sys.stderr:
            print(f"warning: output: {error.strerror}; continuing without it", file=sys.stderr)
        return written
