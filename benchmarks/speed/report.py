"""How long a report takes to rebuild from 1,000 records.

    python benchmarks/speed/report.py --scenes 5 --seeds 50 [--output benchmarks/results/report.md]

Writes made-up records of 4 methods (4 test views of 64 x 48 pixels each) and builds their report
twice in fresh processes. Prints CPU and wall seconds of the quicker build, start-up included, and
writes them to the file of `--output`; exits with 1 if the two differ in a byte.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from tests.report.studies import write_study  # noqa: E402


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", type=int, default=5)
    parser.add_argument("--seeds", type=int, default=50)
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        study = Path(folder) / "study"
        records = write_study(study, options.scenes, options.seeds)
        builds = [_build(study) for _ in range(2)]
    cpu_s, wall_s = (min(times) for times in zip(*(times for times, _ in builds), strict=True))
    same = builds[0][1] == builds[1][1]
    told = (
        f"{records} records, {options.scenes} scenes: {cpu_s:.1f} s of CPU time, {wall_s:.1f} s by"
        f" the wall clock, the quicker of two builds; {'the same bytes' if same else 'DIFFERENT'}."
    )
    command = f"python benchmarks/speed/report.py --scenes {options.scenes} --seeds {options.seeds}"
    print(told)
    if options.output is not None:
        options.output.write_text(f"`{command}`\n\n{told}\n", encoding="utf-8")
    return 0 if same else 1


def _build(study: Path) -> tuple[tuple[float, float], dict[str, bytes]]:
    """(CPU, wall) seconds of a rebuild, and the files it wrote."""
    before, start = _children_cpu_s(), time.perf_counter()
    command = [sys.executable, "-m", "framework.report", str(study)]
    subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
    times = _children_cpu_s() - before, time.perf_counter() - start
    return times, {path.name: path.read_bytes() for path in study.iterdir() if path.is_file()}


def _children_cpu_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


if __name__ == "__main__":
    sys.exit(main())
