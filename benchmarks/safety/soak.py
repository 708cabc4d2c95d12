"""Does a process that does run after run grow? A study of many tiny runs in one process, and one
with joblib's two workers, watched from outside. Exits with 1 if memory grows by more than 5 %
from the thirtieth run to the last, or files, threads or the cache do not stay as they are.

    python benchmarks/safety/soak.py [--runs 300] [--output benchmarks/results/soak.md]

Beside FILE.md it draws FILE.png. Memory is the resident set of the largest process; a point is the
largest of a tenth of the runs, as what is resident swings with every run.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

WARM_RUNS, GROWTH = 30, 1.05
STUDY = [
    *("-m", "study=soak", "threads=2", "depth=ground_truth", "init.budget=300", "augment=safi"),
    *("reg=uar", "capacity=budget", "scene.width=64", "scene.height=48", "scene.supersampling=1"),
    *("trainer.steps=4", "trainer.evaluations=1", "metrics.lpips_weights=none"),
]
LAUNCHERS = {
    "one process": [],
    "joblib, 2 workers": ["hydra/launcher=joblib", "hydra.launcher.n_jobs=2", "threads=1"],
}


@dataclass(frozen=True)
class Sample:
    """After so many runs: the largest process' resident MB, open files and threads."""

    runs: int
    resident: float
    files: int
    threads: int


def family(pid: int) -> list[int]:
    """`pid` and what descends from it."""
    found, rest = [], [pid]
    while rest:
        parent = rest.pop()
        found.append(parent)
        with contextlib.suppress(OSError):
            for task in Path(f"/proc/{parent}/task").iterdir():
                rest += [int(child) for child in (task / "children").read_text().split()]
    return found


def measured(pid: int) -> tuple[float, int, int]:
    """Resident MB, open files and threads of a process; zeros if it is gone."""
    here = Path("/proc") / str(pid)
    with contextlib.suppress(OSError, IndexError):
        pages = int((here / "statm").read_text().split()[1])
        resident = pages * os.sysconf("SC_PAGE_SIZE") / 1e6
        return resident, len(list((here / "fd").iterdir())), len(list((here / "task").iterdir()))
    return 0.0, 0, 0


def watched(runs: int, words: list[str], work: Path) -> list[Sample]:
    """A sample about every half second of the study in a process of its own."""
    work.mkdir()
    command = [sys.executable, str(ROOT / "run.py"), *STUDY, *words, f"seed=range({runs})"]
    samples, log = list[Sample](), work / "log.txt"
    with log.open("wb") as file:
        process = subprocess.Popen(command, cwd=work, stdout=file, stderr=file)
        while process.poll() is None:
            done = len(list(work.glob("reports/soak/runs/*/record.json")))
            if done:
                found = [measured(pid) for pid in family(process.pid)]
                samples.append(Sample(done, *(max(column) for column in zip(*found, strict=True))))
            time.sleep(0.5)
    if process.returncode != 0:
        raise SystemExit(f"{' '.join(command)}: {log.read_text()[-2000:]}")
    return [s for s in samples if s.runs < runs]  # the report comes after the last


def tenths(samples: list[Sample], runs: int) -> list[Sample]:
    """The largest of each tenth of the runs."""
    found = []
    for tenth in range(1, 11):
        part = [s for s in samples if (tenth - 1) * runs < 10 * s.runs <= tenth * runs]
        if part:
            values = ((s.resident, s.files, s.threads) for s in part)
            found.append(Sample(part[-1].runs, *map(max, zip(*values, strict=True))))
    return found


def cache_size() -> tuple[int, int]:
    """Number and bytes of the files in the cache."""
    from framework.files.cache import cache_dir

    files = [path for path in cache_dir().rglob("*") if path.is_file()]
    return len(files), sum(path.stat().st_size for path in files)


def problems(name: str, points: list[Sample], runs: int) -> list[str]:
    """What grew from the first warm point to the last."""
    warm = next(s for s in points if s.runs >= min(WARM_RUNS, runs // 2))
    last, found = points[-1], list[str]()
    if last.resident > GROWTH * warm.resident:
        found.append(f"{name}: memory grew from {warm.resident:.0f} to {last.resident:.0f} MB")
    if last.files > warm.files or last.threads > warm.threads:
        found.append(f"{name}: files or threads grew: {warm} to {last}")
    return found


def draw(curves: dict[str, list[Sample]], path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(5, 3), layout="constrained")
    for name, samples in curves.items():
        axes.plot([s.runs for s in samples], [s.resident for s in samples], label=name)
    axes.set(xlabel="runs done", ylabel="resident memory (MB)", ylim=(0, None))
    axes.legend(frameon=False)
    figure.savefig(path, dpi=100)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=300)
    parser.add_argument("--output", type=Path)
    given = parser.parse_args()
    lines = [f"`python benchmarks/safety/soak.py --runs {given.runs}`", ""]
    lines += ["| study | runs done | resident MB | open files | threads |", "|---|---|---|---|---|"]
    curves, wrong, sizes = dict[str, list[Sample]](), list[str](), [cache_size()]
    with tempfile.TemporaryDirectory() as folder:
        for number, (name, words) in enumerate(LAUNCHERS.items()):
            curves[name] = watched(given.runs, words, Path(folder) / str(number))
            points = tenths(curves[name], given.runs)
            for s in points:
                lines.append(f"| {name} | {s.runs} | {s.resident:.0f} | {s.files} | {s.threads} |")
            wrong += problems(name, points, given.runs)
            sizes.append(cache_size())
    (files, size), last = sizes[1], sizes[-1]
    lines += ["", f"The cache has {last[0]} files, {last[1] / 1e6:.0f} MB after both studies;"]
    lines += [f"after the first it had {files}, {size / 1e6:.0f} MB."]
    lines += wrong or [f"Nothing grew by more than {GROWTH - 1:.0%} after the first runs."]
    text = "\n".join(lines) + "\n"
    print(text)
    if given.output is not None:
        given.output.write_text(text, encoding="utf-8")
        draw(curves, given.output.with_suffix(".png"))
    return int(bool(wrong))


if __name__ == "__main__":
    raise SystemExit(main())
