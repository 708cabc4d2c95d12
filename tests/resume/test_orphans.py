"""Processes that end with another one."""

from __future__ import annotations

import os
import threading

from framework.compute import orphans


def test_a_worker_of_many_runs_watches_its_command_with_one_thread() -> None:
    """A thread for every run was 370 of them after as many runs, and each wakes four times a
    second."""
    before = threading.active_count()
    for _ in range(20):
        orphans.end_with(os.getppid())
    assert threading.active_count() <= before + 1
