"""A small study of two runs, in processes forked from one that has compiled the kernels."""

import os
import signal
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.studies import digests, leftovers
from framework.command import cli
from framework.train.resume import checkpoint

STUDY = [
    *("-m", "augment=safi", "reg=none,uar", "threads=1", "study=disturbed", "depth=ground_truth"),
    *("scene.width=64", "scene.height=48", "scene.supersampling=1", "init.budget=300"),
    *("trainer.evaluations=1", "trainer.steps=60", "metrics.lpips_weights=none"),
]


@dataclass(frozen=True)
class Place:
    """The folder that a study is run in, and the random moments of what disturbs it."""

    folder: Path
    draw: np.random.Generator
    words: tuple[str, ...] = ()

    @property
    def study(self) -> Path:
        return self.folder / "reports" / "disturbed"

    @property
    def log(self) -> str:
        return (self.folder / "log.txt").read_text(errors="replace")

    def begin(self, inside: Callable[[], object] = lambda: None, *more: str) -> int:
        """Id of a new process, which calls `inside` and then runs the study."""
        child = os.fork()
        if child:
            return child
        os.setpgid(0, 0)
        os.chdir(self.folder)
        log = os.open("log.txt", os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        os.dup2(log, 1)
        os.dup2(log, 2)
        sys.stdout, sys.stderr = sys.__stdout__, sys.__stderr__
        checkpoint.COST_TIMES = 0  # a checkpoint after every step
        inside()
        os._exit(cli.main([*STUDY, *self.words, *more]))

    def run(self, inside: Callable[[], object] = lambda: None, *more: str) -> int:
        """Exit code of a process that runs the study to its end."""
        return wait(self.begin(inside, *more))

    def wait_for(self, pattern: str, child: int, seconds: float = 60.0) -> int | None:
        """Wait for a file in the study; the exit code if the process ends before."""
        until = time.monotonic() + seconds
        while time.monotonic() < until and not any(self.study.glob(pattern)):
            if (code := ended(child)) is not None:
                return code
            time.sleep(0.002)
        return None

    def records(self) -> dict[str, tuple[int, int]]:
        """Run -> inode and time of its record: another one if the run was done twice."""
        paths = self.study.glob("runs/*/record.json")
        return {p.parent.name: (p.stat().st_ino, p.stat().st_mtime_ns) for p in paths}

    def finish(self) -> None:
        """Give the command again until it ends well, as its user would. Waits where the workers of
        a killed command are still at a run (exit code 3)."""
        deadline = time.monotonic() + 60
        while (code := self.run()) != 0:
            assert time.monotonic() < deadline, f"still exit code {code}:\n{self.log}"
            time.sleep(0.5)

    def check(self, expected: dict[str, str]) -> None:
        """The study is equal to an undisturbed one, and nothing of a broken run is left."""
        assert digests(self.study) == expected
        assert leftovers(self.study) == []
        assert "Traceback" not in self.log


def ended(child: int) -> int | None:
    """The exit code of a process, negative for a signal; None while it runs."""
    pid, status = os.waitpid(child, os.WNOHANG)
    return os.waitstatus_to_exitcode(status) if pid else None


def wait(child: int) -> int:
    """The exit code of a process when it has ended."""
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def kill(child: int) -> int:
    """Kill a process; returns its exit code, which is another one if it ended before."""
    os.kill(child, signal.SIGKILL)
    return wait(child)
