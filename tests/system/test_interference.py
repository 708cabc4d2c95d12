"""A study survives what happens around it: when the command was given again until it ended well,
the study equals the undisturbed one, and no result is gone or was written twice.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import hashlib
import locale
import os
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from framework.run import experiment
from tests.system.forked import Place, ended, kill, wait

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


def test_two_versions_of_the_code(place: Place, undisturbed: dict[str, str]) -> None:
    for child in [place.begin(), place.begin(other_code)]:
        wait(child)
    place.run(other_code)
    place.finish()  # which replaces the runs of the other version
    place.check(undisturbed)


def other_code() -> None:
    experiment.code_hash = lambda: "0" * 64  # type: ignore[assignment]


def test_clock_that_jumps(place: Place, undisturbed: dict[str, str]) -> None:
    """Between 1970 and 2100, at every look."""

    def inside() -> None:
        true, looks = time.time, [0]

        def jumping() -> float:
            looks[0] += 1
            return (0.0, true() - 86400.0, 4102444800.0, true())[looks[0] % 4]

        time.time = jumping

    place.run(inside)
    settle(place, undisturbed)


def test_machine_that_sleeps(place: Place, undisturbed: dict[str, str]) -> None:
    child = place.begin()
    for _ in range(5):
        time.sleep(0.05 + 0.4 * place.draw.random())
        if ended(child) is not None:
            break
        os.kill(child, signal.SIGSTOP)
        time.sleep(0.5)
        os.kill(child, signal.SIGCONT)
    else:
        wait(child)
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


def test_file_system_without_locks(place: Place, undisturbed: dict[str, str]) -> None:
    """Two processes, one of which is killed, and then a third one."""

    def inside() -> None:
        def flock(*_: object) -> None:
            raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

        fcntl.flock = flock  # type: ignore[assignment]

    children = [place.begin(inside), place.begin(inside)]
    time.sleep(0.5 * place.draw.random())
    kill(children[0])
    wait(children[1])
    place.run(inside)
    settle(place, undisturbed)


def test_cache_that_vanishes(place: Place, undisturbed: dict[str, str]) -> None:
    cache = place.folder / "cache"

    def inside() -> None:
        os.environ["FISHERSPLAT_CACHE"] = str(cache)

    child = place.begin(inside)
    code = place.wait_for("runs/*", child)
    shutil.rmtree(cache, ignore_errors=True)
    if code is None:
        wait(child)
    settle(place, undisturbed)


def test_removed_folder_of_a_run(place: Place, undisturbed: dict[str, str]) -> None:
    child = place.begin()
    code = place.wait_for("runs/*/renders/*.png", child)
    for run in place.study.glob("runs/*"):
        if not (run / "record.json").exists():
            shutil.rmtree(run, ignore_errors=True)
    if code is None:
        wait(child)
    settle(place, undisturbed)


@pytest.mark.parametrize("name", ["SIGHUP", "SIGTERM", "SIGINT"])
def test_signal(name: str, place: Place, undisturbed: dict[str, str]) -> None:
    child = place.begin()
    time.sleep(0.1 + place.draw.random())
    if ended(child) is None:
        os.kill(child, getattr(signal, name))
        wait(child)
    settle(place, undisturbed)


def test_config_dir_that_names_code(place: Place) -> None:
    """Refused before anything is written."""
    experiment_dir = place.folder / "evil" / "experiment"
    experiment_dir.mkdir(parents=True)
    text = "# @package _global_\nhydra: {callbacks: {x: {_target_: os.abort}}}\n"
    (experiment_dir / "smoke.yaml").write_text(text)
    words = ("--config-dir", str(experiment_dir.parent), "experiment=smoke")
    assert place.run(lambda: None, *words) == 2
    assert not place.study.exists()


@pytest.mark.parametrize(
    "change", [lambda data: data[: len(data) // 2], lambda data: bytes(len(data))]
)
def test_damaged_checkpoint(
    change: Callable[[bytes], bytes], place: Place, undisturbed: dict[str, str]
) -> None:
    """Cut short, or all zeros, under a name with its right checksum."""
    child = place.begin()
    if place.wait_for("runs/*/checkpoints/step-*", child) is None:
        kill(child)
    for path in place.study.glob("runs/*/checkpoints/step-*.safetensors"):
        content = change(path.read_bytes())
        digest = hashlib.sha256(content).hexdigest()[:32]
        path.with_name(f"{path.name.rsplit('-', 1)[0]}-{digest}.safetensors").write_bytes(content)
        path.unlink()
    settle(place, undisturbed)


def test_turkish_locale(place: Place, undisturbed: dict[str, str]) -> None:
    """Where "i" is no small "I", and numbers have a decimal comma."""
    locales = make_locale(place.folder / "locales")

    def inside() -> None:
        os.environ |= {"LC_ALL": "tr_TR.UTF-8", "LOCPATH": str(locales)}
        with contextlib.suppress(locale.Error):
            locale.setlocale(locale.LC_ALL, "tr_TR.UTF-8")

    place.run(inside)
    settle(place, undisturbed)


def make_locale(folder: Path) -> Path:
    """Without `localedef` only the variables are set."""
    folder.mkdir()
    with contextlib.suppress(OSError):
        command = ["localedef", "-i", "tr_TR", "-f", "UTF-8", str(folder / "tr_TR.UTF-8")]
        subprocess.run(command, capture_output=True)
    return folder
