"""Processes that end with another one."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from framework.command.config.schema import ROOT
from framework.compute import orphans


def test_a_worker_of_many_runs_watches_its_command_with_one_thread() -> None:
    """A thread for every run was 370 of them after as many runs, and each wakes four times a
    second."""
    before = threading.active_count()
    for _ in range(20):
        orphans.end_with(os.getppid())
    assert threading.active_count() <= before + 1


KILLED = """
import os, signal
from joblib import Parallel, delayed
from framework.command.launchers.supported import watch_workers

watch_workers()
watch_workers()  # as a second study of the same process does
print(*{n for n in Parallel(n_jobs=2)(delayed(os.getpid)() for _ in range(20))}, flush=True)
os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
def test_workers_that_never_had_a_run_end_with_their_command(tmp_path: Path) -> None:
    """joblib's own stay: for five minutes, or for ever if their command was killed while it sent
    them something."""
    with (tmp_path / "told").open("w") as message:  # a pipe would be held open by those who stay
        done = subprocess.run([sys.executable, "-c", KILLED], cwd=ROOT, stdout=message, check=False)
    workers = [int(word) for word in (tmp_path / "told").read_text().split()]
    assert workers and done.returncode == -signal.SIGKILL
    until = time.monotonic() + 60
    while left := [worker for worker in workers if Path(f"/proc/{worker}").exists()]:
        assert time.monotonic() < until, left
        time.sleep(0.05)
