"""Runs per hour: one run after another on all cores, or as many single-thread runs as cores.

    python benchmarks/speed/throughput.py [--runs 6] [--output FILE] [OVERRIDE ...]

Both are whole studies through `run.py`, kernels cached by a short one before: start-up, depth,
training, evaluation, files and report count. Overrides are those of `run.py`. The machine should be
idle. Writes a markdown table to FILE, or prints it.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from framework.records.provenance import cpu_model  # noqa: E402

METHOD = ["+augment=safi", "+reg=uar"]


def seconds(folder: Path, overrides: list[str]) -> float:
    """Wall time of one command that must succeed."""
    line = [sys.executable, str(ROOT / "run.py"), "-m", f"hydra.sweep.dir={folder}", *overrides]
    start = time.perf_counter()
    subprocess.run(line, cwd=ROOT, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    return time.perf_counter() - start


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=6)
    parser.add_argument("--output", type=Path)
    parser.add_argument("overrides", nargs="*")
    given = parser.parse_args()
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    seeds = "seed=" + ",".join(map(str, range(given.runs)))
    line = [*METHOD, *given.overrides]
    side = ["hydra/launcher=joblib", f"hydra.launcher.n_jobs={cores}", "threads=1"]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        seconds(folder / "warm", [*line, "seed=0", "trainer.steps=10"])
        one = seconds(folder / "one", [*line, seeds])
        many = seconds(folder / "many", [*line, seeds, *side])
    text = "\n".join(
        [
            "# Sweep throughput",
            "",
            "`benchmarks/speed/throughput.py"
            f" {' '.join(w for w in given.overrides if 'path' not in w)}`, {given.runs} runs of"
            f" SAFI + UAR on {cpu_model()}, {cores} cores, start-up and report included.",
            "",
            "| how | seconds | runs per hour |",
            "|---|---:|---:|",
            f"| one after another, {cores} threads | {one:.0f} | {given.runs / one * 3600:.0f} |",
            f"| {cores} side by side, 1 thread | {many:.0f} | {given.runs / many * 3600:.0f} |",
            "",
        ]
    )
    print(text)
    if given.output:
        given.output.write_text(text)


if __name__ == "__main__":
    main()
