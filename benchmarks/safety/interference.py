"""Does a study survive what happens around it? Exits with 1 if something is lost or changed.

One small study runs undisturbed. Then the same study is begun in many ways that the world has to
disturb it: a disk that is full for a while, a clock that jumps, a process that sleeps, a second
one at the same study, with other code, without locks, a cache that vanishes, another locale. After
each the command is given again, undisturbed, until it ends well. The study must equal the
undisturbed one, hold no leftovers, and no result may be gone or written twice with one code.

Every attempt is a process forked from one that has imported everything and compiled the kernels;
what disturbs it from within is put in its place in the fork.

    python benchmarks/safety/interference.py [--steps 60] [--output FILE.md]
"""

from __future__ import annotations

import argparse
import contextlib
import errno
import fcntl
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from benchmarks.safety.kill import SMALL, begin, ended, records, warm_up  # noqa: E402
from benchmarks.studies import digests, leftovers, parameters  # noqa: E402
from framework.compute.rng import stream  # noqa: E402

MOST_ATTEMPTS = 4  # undisturbed ones after the disturbance
SLOW_COST_TIMES = 0  # a checkpoint after every step, so that each disturbance meets some


@dataclass(frozen=True)
class Place:
    """Where a study is disturbed: its folder and command, and a stream of draws."""

    folder: Path
    words: list[str]
    draw: Any

    @property
    def study(self) -> Path:
        return self.folder / "reports" / "kill"

    def begin(self, inside: Callable[[], object] = lambda: None, more: tuple[str, ...] = ()) -> int:
        """Begin the study in a fork, which calls `inside` first."""
        return begin(self.folder, [*self.words, *more], inside)

    def wait_for(self, pattern: str, child: int, seconds: float = 60.0) -> int | None:
        """Wait for a file in the study; the exit code if the process ends before."""
        until = time.monotonic() + seconds
        while time.monotonic() < until and not any(self.study.glob(pattern)):
            if (code := ended(child)) is not None:
                return code
            time.sleep(0.002)
        return None


Codes = list[int | None]


def two_at_once(place: Place) -> Codes:
    """Two processes with the same command."""
    children = [place.begin(), place.begin()]
    return [ended(child, wait=True) for child in children]


def two_versions(place: Place) -> Codes:
    """Another version of the code at the same study at the same time, and once more after it."""
    child, other = place.begin(), place.begin(_other_code)
    codes = [ended(child, wait=True), ended(other, wait=True)]
    return [*codes, ended(place.begin(_other_code), wait=True)]


def _other_code() -> None:
    from framework.run import experiment

    experiment.code_hash = lambda: "0" * 64  # type: ignore[assignment]


def clock_jumps(place: Place) -> Codes:
    """The wall clock goes back and forth between 1970 and 2100 at every look."""
    return [ended(place.begin(_jumping_clock), wait=True)]


def _jumping_clock() -> None:
    true, looks = time.time, [0]

    def jumping() -> float:
        looks[0] += 1
        return (0.0, true() - 86400.0, 4102444800.0, true())[looks[0] % 4]

    time.time = jumping


def sleeps(place: Place) -> Codes:
    """Stopped and taken up again, as by a laptop that sleeps, five times."""
    child = place.begin()
    for _ in range(5):
        time.sleep(0.05 + 0.4 * place.draw.random())
        if (code := ended(child)) is not None:
            return [code]
        os.kill(child, signal.SIGSTOP)
        time.sleep(0.5)
        os.kill(child, signal.SIGCONT)
    return [ended(child, wait=True)]


def full_disk(place: Place, empties: bool) -> Codes:
    """A real, small disk fills while a checkpoint is written; it empties at once, or later."""
    child = place.begin()
    code = place.wait_for("runs/*/checkpoints/.step-*.tmp", child)
    filler = place.folder / "filler"
    with contextlib.suppress(OSError), filler.open("wb", buffering=0) as file:
        while True:
            file.write(bytes(1 << 16))
    if empties:
        time.sleep(0.1)
        filler.unlink()
    code = ended(child, wait=True) if code is None else code
    filler.unlink(missing_ok=True)
    return [code]


def no_locks(place: Place) -> Codes:
    """Two processes where the file system has no locks; one is killed, and a third one begins."""
    children = [place.begin(_without_locks), place.begin(_without_locks)]
    time.sleep(0.5 * place.draw.random())
    os.kill(children[0], signal.SIGKILL)
    codes = [ended(child, wait=True) for child in children]
    return [*codes, ended(place.begin(_without_locks), wait=True)]


def _without_locks() -> None:
    def flock(*_: object) -> None:
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    fcntl.flock = flock  # type: ignore[assignment]


def cache_vanishes(place: Place) -> Codes:
    """The cache of scenes is emptied while runs use it."""
    cache = place.folder / "cache"

    def own_cache() -> None:  # the kernels are in memory
        os.environ["FISHERSPLAT_CACHE"] = str(cache)

    child = place.begin(own_cache)
    place.wait_for("runs/*", child)
    shutil.rmtree(cache, ignore_errors=True)
    return [ended(child, wait=True)]


def run_removed(place: Place) -> Codes:
    """Somebody removes the folder of a run that is being written."""
    child = place.begin()
    code = place.wait_for("runs/*/renders/*.png", child)
    for run in place.study.glob("runs/*"):
        if not (run / "record.json").exists():
            shutil.rmtree(run, ignore_errors=True)
    return [ended(child, wait=True) if code is None else code]


def hung_up(place: Place, name: str) -> Codes:
    """The terminal closes, the system shuts down, or somebody presses Ctrl-C."""
    child = place.begin()
    time.sleep(0.1 + place.draw.random())
    if (code := ended(child)) is not None:
        return [code]
    os.kill(child, getattr(signal, name))
    return [ended(child, wait=True)]


def turkish(place: Place) -> Codes:
    """Where "i" is no small "I" and numbers have a decimal comma: for C libraries, too. Where the
    locale is not installed, and cannot be made here, only the variables are set."""
    locales = place.folder / "locales"
    command = ["localedef", "-i", "tr_TR", "-f", "UTF-8", str(locales / "tr_TR.UTF-8")]
    locales.mkdir()
    with contextlib.suppress(OSError):
        subprocess.run(command, capture_output=True)

    def inside() -> None:
        import locale

        os.environ |= {"LC_ALL": "tr_TR.UTF-8", "LOCPATH": str(locales)}
        with contextlib.suppress(locale.Error):
            locale.setlocale(locale.LC_ALL, "tr_TR.UTF-8")
            print(f"one half is {locale.str(0.5)}", flush=True)

    code = ended(place.begin(inside), wait=True)
    if "one half is 0,5" not in (place.folder / "log.txt").read_text():
        return [code, None]
    return [code]


def config_dir(place: Place) -> Codes:
    """`--config-dir` with a configuration that would run code: refused, and nothing is written."""
    evil = place.folder / "evil" / "experiment"
    evil.mkdir(parents=True)
    (evil / "smoke.yaml").write_text(
        "# @package _global_\nhydra: {callbacks: {x: {_target_: os.abort}}}\n"
    )
    child = place.begin(more=("--config-dir", str(evil.parent), "experiment=smoke"))
    code = ended(child, wait=True)
    if code != 2 or place.study.exists():
        raise SystemExit(f"--config-dir: expected a refusal, got {code}")
    return [code]


def forged_checkpoint(place: Place, change: Callable[[bytes], bytes]) -> Codes:
    """Killed once there is a checkpoint, which is then forged under a name that fits it."""
    import hashlib

    child = place.begin()
    code = place.wait_for("runs/*/checkpoints/step-*", child)
    if code is None:
        os.kill(child, signal.SIGKILL)
        code = ended(child, wait=True)
    for path in place.study.glob("runs/*/checkpoints/step-*.safetensors"):
        content = change(path.read_bytes())
        digest = hashlib.sha256(content).hexdigest()[:32]
        path.with_name(f"{path.name.rsplit('-', 1)[0]}-{digest}.safetensors").write_bytes(content)
        path.unlink()
    return [code]


WAYS: dict[str, tuple[int, Callable[[Place], Codes]]] = {
    "two processes at one study": (3, two_at_once),
    "two versions of the code at one study": (2, two_versions),
    "a clock that jumps between 1970 and 2100": (1, clock_jumps),
    "stopped and continued five times": (2, sleeps),
    "a disk that fills at a checkpoint and empties at once": (2, partial(full_disk, empties=True)),
    "a disk that fills at a checkpoint and stays full": (2, partial(full_disk, empties=False)),
    "two processes without locks, one killed": (3, no_locks),
    "an emptied cache": (1, cache_vanishes),
    "the folder of a run removed": (1, run_removed),
    "SIGHUP": (1, partial(hung_up, name="SIGHUP")),
    "SIGTERM": (1, partial(hung_up, name="SIGTERM")),
    "SIGINT": (1, partial(hung_up, name="SIGINT")),
    "--config-dir with code in it": (1, config_dir),
    "a checkpoint cut short": (1, partial(forged_checkpoint, change=lambda b: b[: len(b) // 2])),
    "a checkpoint of zeros": (1, partial(forged_checkpoint, change=lambda b: bytes(len(b)))),
    "a Turkish locale": (1, turkish),
}
NEEDS_DISK = ("a disk that fills",)


@contextmanager
def small_disk(folder: Path, wanted: bool) -> Iterator[bool]:
    """A file system of 24 MB at `folder`, where it is wanted and this user may mount one."""
    folder.mkdir()
    if not wanted:
        yield True
        return
    command = ["mount", "-t", "tmpfs", "-o", "size=24m", "tmpfs", str(folder)]
    mounted = subprocess.run(command, capture_output=True).returncode == 0
    try:
        yield mounted
    finally:
        if mounted:
            subprocess.run(["umount", "-l", str(folder)], check=False)


@dataclass
class Row:
    """What came of one kind. codes: of the disturbed attempts; faults: what is wrong."""

    name: str
    times: int
    codes: list[str]
    faults: list[str]


def disturbed(place: Place, way: Callable[[Place], Codes], whole: dict[str, str]) -> Row:
    """One disturbance and the attempts after it."""
    codes, faults = way(place), list[str]()
    complete = parameters(place.study)  # a failed one is to be written again
    known = {run: file for run, file in records(place.study).items() if run in complete}
    for _ in range(MOST_ATTEMPTS):
        code = ended(place.begin(), wait=True)
        if code == 0:
            break
    else:
        faults.append(f"still {code} after {MOST_ATTEMPTS} attempts")
        return Row("", 1, [str(c) for c in codes], faults)
    now = records(place.study)
    if way is not two_versions:  # the other version's runs are done again
        faults += [f"{run} done twice" for run, record in known.items() if now[run] != record]
    found = digests(place.study)
    faults += sorted(k for k in {*found, *whole} if found.get(k) != whole.get(k))[:3]
    faults += leftovers(place.study)
    log = (place.folder / "log.txt").read_text(errors="replace")
    faults += ["a traceback"] * ("Traceback" in log)
    return Row("", 1, [str(c) for c in codes], faults)


def measure(words: list[str], work: Path, only: str) -> list[Row]:
    """All disturbances with `only` in their names."""
    (work / "whole").mkdir()
    code = ended(begin(work / "whole", words), wait=True)
    if code != 0:
        raise SystemExit((work / "whole" / "log.txt").read_text())
    study = work / "whole" / "reports" / "kill"
    whole, rows = digests(study), list[Row]()
    assert parameters(study)
    for kind, (name, (times, way)) in enumerate(WAYS.items()):
        if only not in name:
            continue
        row = Row(name, 0, [], [])
        for time_ in range(times):
            folder = work / f"{kind}-{time_}"
            with small_disk(folder, name.startswith(NEEDS_DISK)) as there:
                if not there:
                    row.codes.append("not tried: no right to mount")
                    continue
                place = Place(folder, words, stream(time_, f"interference/{name}"))
                one = disturbed(place, way, whole)
            row.times += 1
            row.codes += one.codes
            row.faults += one.faults
        rows.append(row)
        print(row, flush=True)
    return rows


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=60)
    parser.add_argument("--output", type=Path)
    parser.add_argument("--only", default="", help="kinds with this in their names")
    given = parser.parse_args()
    from framework.train.resume import checkpoint

    with tempfile.TemporaryDirectory() as folder:
        warm_up(Path(folder) / "warm", SMALL)
        checkpoint.COST_TIMES = SLOW_COST_TIMES
        words = [*SMALL, f"trainer.steps={given.steps}", "metrics.lpips_weights=none"]
        rows = measure(words, Path(folder), given.only)
    shown = f" --only {given.only!r}" if given.only else ""
    lines = [f"`python benchmarks/safety/interference.py --steps {given.steps}{shown}`", ""]
    lines += ["| what disturbs a study of two runs | times | exit codes meanwhile | wrong after |"]
    lines += ["|---|---|---|---|"]
    for row in rows:
        wrong = "; ".join(row.faults) or "nothing"
        lines.append(f"| {row.name} | {row.times} | {', '.join(row.codes)} | {wrong} |")
    bad = sum(bool(row.faults) for row in rows)
    lines += ["", f"{sum(row.times for row in rows)} interferences, {bad} kinds with a fault."]
    text = "\n".join(lines) + "\n"
    print(text)
    if given.output is not None:
        given.output.write_text(text, encoding="utf-8")
    return int(bool(bad))


if __name__ == "__main__":
    raise SystemExit(main())
