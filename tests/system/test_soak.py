"""A process that does run after run does not grow: its memory, open files and threads."""

import contextlib
import os
import subprocess
import sys
import time
from pathlib import Path
from statistics import median

import pytest

from framework.command.config.schema import ROOT

pytestmark = [pytest.mark.slow, pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")]

RUNS, WARM_RUNS, GROWTH = 150, 50, 1.05
STUDY = [
    *("-m", "study=soak", "depth=ground_truth", "init.budget=300", "augment=safi"),
    *("reg=uar", "capacity=budget", "scene.width=64", "scene.height=48", "scene.supersampling=1"),
    *("trainer.steps=4", "trainer.evaluations=1", "metrics.lpips_weights=none"),
    f"seed=range({RUNS})",
]
LAUNCHERS = {
    "one process": ["threads=2"],
    "joblib": ["hydra/launcher=joblib", "hydra.launcher.n_jobs=2", "threads=1"],
}
Sample = tuple[float, int, int]  # resident MB, open files, threads


def family(pid: int) -> list[int]:
    """`pid` and what descends from it."""
    actual, rest = [], [pid]
    while rest:
        parent = rest.pop()
        actual.append(parent)
        with contextlib.suppress(OSError):
            for task in Path(f"/proc/{parent}/task").iterdir():
                rest += [int(child) for child in (task / "children").read_text().split()]
    return actual


def measured(pid: int) -> Sample:
    """Memory and handles of one process; zeros if it has ended."""
    folder = Path(f"/proc/{pid}")
    with contextlib.suppress(OSError, IndexError):
        pages = int((folder / "statm").read_text().split()[1])
        megabytes = pages * os.sysconf("SC_PAGE_SIZE") / 1e6
        return (
            megabytes,
            len(list((folder / "fd").iterdir())),
            len(list((folder / "task").iterdir())),
        )
    return 0.0, 0, 0


@pytest.mark.parametrize("launcher", LAUNCHERS)
def test_nothing_grows(launcher: str, tmp_path: Path) -> None:
    """The largest process, from the runs after the first ones to the last ones."""
    command = [sys.executable, str(ROOT / "run.py"), *STUDY, *LAUNCHERS[launcher]]
    samples: list[tuple[int, Sample]] = []
    with (tmp_path / "log.txt").open("wb") as log:
        process = subprocess.Popen(command, cwd=tmp_path, stdout=log, stderr=log)
        while process.poll() is None:
            done = len(list(tmp_path.glob("reports/soak/runs/*/record.json")))
            each = [measured(pid) for pid in family(process.pid)]
            samples.append((done, tuple(max(column) for column in zip(*each, strict=True))))
            time.sleep(0.5)
    assert process.returncode == 0, (tmp_path / "log.txt").read_text()
    warm = [sample for done, sample in samples if WARM_RUNS <= done < (WARM_RUNS + RUNS) / 2]
    last = [sample for done, sample in samples if (WARM_RUNS + RUNS) / 2 <= done < RUNS]
    (memory, *handles), (memory_then, *handles_then) = (zip(*s, strict=True) for s in (warm, last))
    assert max(memory_then) <= GROWTH * max(memory)
    for before, then in zip(handles, handles_then, strict=True):  # a sample may catch a write
        assert median(then) <= median(before)
