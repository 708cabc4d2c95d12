"""A study survives disturbances: after its command is repeated until it succeeds, it equals the
undisturbed study. No result is lost or written twice.
"""

import contextlib
import os
import signal
import subprocess
import time
from collections.abc import Iterator
from dataclasses import replace

import pytest

from tests.system.forked import Place, ended, wait

pytestmark = pytest.mark.slow


def settle(place: Place, undisturbed: dict[str, str]) -> None:
    """Give the command again; then the study is whole, and complete runs were not repeated."""
    before = complete(place)
    place.finish()
    assert before.items() <= place.records().items()
    place.check(undisturbed)


def complete(place: Place) -> dict[str, tuple[int, int]]:
    """The records of the runs that did not fail."""
    failed = {path.parent.name for path in place.study.glob("runs/*/failed.json")}
    return {run: record for run, record in place.records().items() if run not in failed}


def test_two_processes(place: Place, undisturbed: dict[str, str]) -> None:
    for child in [place.begin(), place.begin()]:
        assert wait(child) in (0, 3)
    settle(place, undisturbed)


@pytest.fixture
def small_disk(place: Place) -> Iterator[Place]:
    """A file system of 24 MB, where this user may mount one."""
    folder = place.folder / "disk"
    folder.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=24m", "tmpfs", str(folder)]
    if subprocess.run(command, capture_output=True).returncode != 0:
        pytest.skip("no right to mount a file system")
    yield replace(place, folder=folder)
    subprocess.run(["umount", "-l", str(folder)], check=True)


@pytest.mark.parametrize("seconds", [0.1, None], ids=["for a moment", "for good"])
def test_full_disk_at_a_checkpoint(
    seconds: float | None, small_disk: Place, undisturbed: dict[str, str]
) -> None:
    child = small_disk.begin()
    code = small_disk.wait_for("runs/*/checkpoints/.step-*.tmp", child)
    filler = small_disk.folder / "filler"
    with contextlib.suppress(OSError), filler.open("wb", buffering=0) as file:
        while True:
            file.write(bytes(1 << 16))
    if seconds is not None:
        time.sleep(seconds)
        filler.unlink()
    if code is None:
        wait(child)
    filler.unlink(missing_ok=True)
    settle(small_disk, undisturbed)


@pytest.mark.parametrize("name", ["SIGHUP", "SIGTERM", "SIGINT"])
def test_signal(name: str, place: Place, undisturbed: dict[str, str]) -> None:
    child = place.begin()
    time.sleep(0.1 + place.draw.random())
    if ended(child) is None:
        os.kill(child, getattr(signal, name))
        wait(child)
    settle(place, undisturbed)
