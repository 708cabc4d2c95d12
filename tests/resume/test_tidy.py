"""Leftovers of killed commands and unused entries are removed from the user's cache."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from framework.command.config.schema import ROOT
from framework.files import tidy
from framework.files.tidy import DAY_S, YOUNG_S, own_folder

OWNER = """
import time
from framework.files.tidy import own_folder
with own_folder("ledger-") as folder:
    print(folder, flush=True)
    time.sleep(100)
"""


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("FISHERSPLAT_CACHE", str(tmp_path))
    return tmp_path


def age(path: Path, seconds: float) -> None:
    then = time.time() - seconds
    os.utime(path, (then, then))


def folders(cache: Path) -> set[str]:
    return {path.name for path in cache.glob("ledger-*")}


def test_a_folder_goes_with_its_owner(cache: Path) -> None:
    with own_folder("ledger-") as folder:
        assert folder.parent == cache and folder.is_dir()
    assert not folders(cache)


def test_a_killed_owners_folder_goes_and_a_living_ones_stays(cache: Path) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", OWNER], cwd=ROOT, stdout=subprocess.PIPE, text=True
    ) as owner:
        assert owner.stdout is not None
        folder = Path(owner.stdout.readline().strip())
        age(folder, 2 * YOUNG_S)
        with own_folder("ledger-"):
            assert folder.is_dir(), "its owner lives"
        owner.send_signal(signal.SIGKILL)
        owner.wait()
        assert folder.is_dir(), "it could not be removed"
        age(folder, 0.0)
        with own_folder("ledger-") as other:
            assert folders(cache) == {folder.name, other.name}, "perhaps just made"
        age(folder, 2 * YOUNG_S)
        with own_folder("ledger-") as other:
            assert folders(cache) == {other.name}


def test_another_versions_folder_has_no_lock_and_stays_for_days(cache: Path) -> None:
    young, old = cache / "ledger-young", cache / "ledger-old"
    for path, days in ((young, tidy.UNSIGNED_DAYS - 1), (old, tidy.UNSIGNED_DAYS + 1)):
        path.mkdir()
        (path / "000000.json").write_text("{}")
        age(path, days * DAY_S)
    with own_folder("ledger-") as ours:
        assert folders(cache) == {young.name, ours.name}


def test_what_nobody_uses_goes_once_a_day_and_the_rest_stays(cache: Path) -> None:
    long_ago = (tidy.UNUSED_DAYS + 1) * DAY_S
    old = [cache / "kernels" / "a" / "k.nbi", cache / "embedded-1.npz"]
    used = [cache / "kernels" / "b" / "k.nbi", cache / "embedded-2.npz"]
    dear = [cache / "poses" / "x" / "poses.json", cache / "lpips" / "w.safetensors"]
    for path in (*old, *used, *dear):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"x")
        age(path, 10.0 if path in used else long_ago)
    tidy.tidy("ledger-")
    assert not any(path.exists() for path in old) and not (cache / "kernels" / "a").exists()
    assert all(path.exists() for path in (*used, *dear))
    age(used[1], long_ago)
    tidy.tidy("ledger-")
    assert used[1].exists(), "looked today"
    age(cache / tidy.DAILY, DAY_S + 1)
    tidy.tidy("ledger-")
    assert not used[1].exists()


def test_a_cache_that_cannot_be_tidied_stops_nobody(
    cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(path: Path) -> float:
        raise PermissionError(path)

    monkeypatch.setattr(tidy, "_last_used", refused)
    (cache / "embedded-1.npz").write_bytes(b"x")
    with own_folder("ledger-") as folder:
        assert folder.is_dir()
