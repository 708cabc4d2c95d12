"""A run as the command line hands it to whoever does it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Job:
    """One run as the command line wants it, of plain data. label, short_label: who speaks in
    progress lines. alone: no other run writes to the terminal. multirun: one of several runs.
    again: the command that does this run alone."""

    number: int
    run_dir: str
    config: dict[str, Any]
    overrides: list[str]
    label: str
    short_label: str
    alone: bool
    multirun: bool
    again: str
