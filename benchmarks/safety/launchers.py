"""The same study by every launcher: the same bytes? And what does each cost? Exits with 1 if not.

One study runs in one process, and then with joblib, Ray and submitit, two runs at a time, one way
after another. Each must leave the parameters, tables and report of the first, measured times aside
(`benchmarks/studies.py` tells in what). With `--kills` two ways more: a worker is killed by SIGKILL
in the middle, and the command itself is; then the same command again.

    python benchmarks/safety/launchers.py [--runs 24] [--steps 12] [--kills] [--only NAME ...]

Wall times hold for the machine as it was: compare the rows of one table. The memory of the command
is its process' own peak; the report's seconds are those of building it again from the records.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shlex
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from benchmarks.studies import digests, leftovers  # noqa: E402

STUDY = [
    *("-m", "study=far", "threads=1", "depth=ground_truth", "init.budget=300"),
    *("scene.width=64", "scene.height=48", "scene.supersampling=1", "trainer.evaluations=1"),
]
SUBMITIT = ["hydra/launcher=submitit_local", "hydra.launcher.n_jobs=2"]
RAY = ["hydra/launcher=ray", "+hydra.launcher.ray.init.num_cpus=2"]
TICKS = os.sysconf("SC_CLK_TCK")
WAYS = {
    "one process": [],
    "joblib, 2": ["hydra/launcher=joblib", "hydra.launcher.n_jobs=2"],
    "Ray, 2": RAY,
    "submitit, 2": SUBMITIT,
}
KILLED = {"Ray": RAY, "submitit": SUBMITIT}


@dataclass(frozen=True)
class Way:
    """cpu_s: of the command and all processes under it, as they were last seen."""

    name: str
    code: int
    wall_s: float
    cpu_s: float
    driver_mb: float
    study: Path


def begin(folder: Path, words: list[str]) -> subprocess.Popen[bytes]:
    folder.mkdir(exist_ok=True)
    with (folder / "log.txt").open("ab") as log:
        command = [sys.executable, str(ROOT / "run.py"), *STUDY, *words]
        return subprocess.Popen(command, cwd=folder, stdout=log, stderr=log)


def look(pid: int, used: dict[int, float]) -> None:
    """Note in `used` the CPU seconds of a process and of all under it; an ended one keeps its last.
    Ray's daemons are nobody's to wait for, so the kernel's sum over children misses them."""
    parents, now = {}, {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            rest = path.read_text().rpartition(") ")[2].split()
        except OSError:  # ended meanwhile
            continue
        number = int(path.parent.name)
        parents[number], now[number] = int(rest[1]), (int(rest[11]) + int(rest[12])) / TICKS
    for number in now:
        above = number
        while above not in (pid, 0, 1):
            above = parents.get(above, 0)
        if above == pid:
            used[number] = now[number]


def peak_mb(pid: int) -> float:
    """Of a process that lives; 0 else."""
    try:
        text = Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return 0.0
    (line,) = [line for line in text.splitlines() if line.startswith("VmHWM")] or ["x 0"]
    return int(line.split()[1]) / 1024


def run(name: str, folder: Path, words: list[str]) -> Way:
    started, memory = time.monotonic(), 0.0
    used: dict[int, float] = {}
    process = begin(folder, words)
    while process.poll() is None:
        memory = max(memory, peak_mb(process.pid))
        look(process.pid, used)
        time.sleep(0.3)
    wall_s = time.monotonic() - started
    code = process.returncode
    print(f"{name}: exit code {code}, {wall_s:.0f} s", flush=True)
    return Way(name, code, wall_s, sum(used.values()), memory, folder / "reports" / "far")


def _children_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def killed(name: str, folder: Path, words: list[str], driver: bool) -> Way:
    """The command, with a SIGKILL when a third of its runs is done, and then again."""
    process = begin(folder, words)
    study = folder / "reports" / "far"
    third = int(words[-1].partition("(")[2].rstrip(")")) // 3
    while len(list(study.glob("runs/*/record.json"))) < third:
        time.sleep(0.05)
        assert process.poll() is None, "ended before it was killed"
    victim = process.pid if driver else _holder(study)
    os.kill(victim, signal.SIGKILL)
    first = process.wait()
    time.sleep(3)  # its workers notice
    again = run(f"{name}, killed and again", folder, words)
    what = "the command" if driver else "a worker"
    text = f"{name}: {what} killed (exit code {first}), then again"
    return Way(text, again.code, again.wall_s, again.cpu_s, again.driver_mb, study)


def _holder(study: Path) -> int:
    while True:
        for path in study.glob("runs/*/.lock"):
            try:
                return int(json.loads(path.read_text())["pid"])
            except (OSError, ValueError):
                continue
        time.sleep(0.01)


def problems(way: Way, expected: dict[str, str], runs: int) -> list[str]:
    found = digests(way.study)
    differing = sorted(k for k in {*found, *expected} if found.get(k) != expected.get(k))
    records = len(list(way.study.glob("runs/*/record.json")))
    checks = {
        f"exit code {way.code}": way.code == 0,
        f"{records} records": records == runs,
        f"leftovers {leftovers(way.study)}": not leftovers(way.study),
        f"differs: {differing[:5]} ...": not differing,
    }
    return [f"{way.name}: {text}" for text, good in checks.items() if not good]


def report_s(study: Path) -> float:
    """CPU seconds of building the report again, in a process of its own."""
    before = _children_s()
    subprocess.run(
        [sys.executable, str(ROOT / "run.py"), "report", str(study)],
        check=True,
        capture_output=True,
    )
    return _children_s() - before


def training_s(study: Path) -> float:
    """CPU seconds of all trainings, as their records have them."""
    records = [json.loads(path.read_text()) for path in study.glob("runs/*/record.json")]
    stages = [stage for record in records for stage in record["timings"]]
    return sum(float(stage["cpu_s"]) for stage in stages if stage["stage"] == "train")


def table(ways: list[Way], runs: int, reports: float, in_training: float, line: str) -> str:
    first = ways[0]
    rows = [
        f"| {w.name} | {w.wall_s:.0f} | {3600 * runs / w.wall_s:.0f}"
        f" | {first.wall_s / w.wall_s:.2f} | {w.cpu_s / runs:.2f} | {w.driver_mb:.0f} |"
        if w.name in WAYS
        else f"| {w.name} | {w.wall_s:.0f} | | | | {w.driver_mb:.0f} |"  # a part was done before
        for w in ways
    ]
    return "\n".join(
        [
            f"`{line}`",
            "",
            "| way | wall s | runs an hour | ratio | CPU s a run | MB of the command |",
            "|---|---|---|---|---|---|",
            *rows,
            "",
            f"{runs} runs, {in_training / runs:.2f} CPU s of training in each of the first way's;"
            f" the report again takes {reports:.1f} CPU s.",
            "",
        ]
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=24)
    parser.add_argument("--steps", type=int, default=12, help="of a training")
    parser.add_argument("--kills", action="store_true")
    parser.add_argument("--only", nargs="*", default=list(WAYS), choices=list(WAYS))
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    STUDY.append(f"trainer.steps={options.steps}")
    seeds = f"seed=range({options.runs})"
    with tempfile.TemporaryDirectory() as work:
        ways = [
            run(name, Path(work) / name.replace(", ", "-").replace(" ", "-"), [*WAYS[name], seeds])
            for name in options.only
        ]
        if options.kills:
            for name, words in KILLED.items():
                for driver in (False, True):
                    folder = Path(work) / f"killed-{name}-{driver}"
                    ways.append(killed(name, folder, [*words, seeds], driver))
        expected = digests(ways[0].study)
        wrong = [text for way in ways for text in problems(way, expected, options.runs)]
        reports = report_s(ways[0].study)
        in_training = training_s(ways[0].study)
    line = shlex.join(["python", str(Path(__file__).relative_to(ROOT)), *sys.argv[1:]])
    text = table(ways, options.runs, reports, in_training, line)
    text += "".join(f"- {line}\n" for line in wrong) or (
        "All ways left the same bytes: parameters, metrics, renders, tables and report, measured"
        " times aside; no leftovers, nothing lost or done twice.\n"
    )
    print(text)
    if options.output:
        options.output.write_text(text, encoding="utf-8")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
