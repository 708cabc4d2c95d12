"""Is anything lost or changed when the runs of a study are killed? Exits with 1 if so.

One small study runs undisturbed. Then the same study is begun again and again and its process is
killed by SIGKILL, half of the times at a random moment, else while it writes a certain file: a
checkpoint, a table, a record, the report. After each kill the same command is given again. When a
study is complete it must equal the undisturbed one (`benchmarks/studies.py` tells in what), hold no
leftovers, and no run may have been done twice; then a new one is begun, until all kills are spent.

Every attempt is a process forked from one that has imported everything and compiled the kernels.

    python benchmarks/safety/kill.py [--kills 52] [--steps 80] [--output benchmarks/results/kill.md]
        [--capacities fixed,budget] [--launchers basic,joblib] [--seed 1] [--counts FILE]

With several capacities and launchers each pair gets its share of the kills; all launchers' studies
must equal the undisturbed one of the first launcher. Where a kind of file is not seen in a whole
study (a worker that is started anew writes no checkpoint in so short a run), the kill comes at any
moment instead. With `--counts` the kills of several calls, of other seeds, add up in one table.

`--small` is a study of two shorter runs, killed once at each kind of moment where no --kills are
given.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from benchmarks.studies import digests, leftovers, parameters  # noqa: E402
from framework.compute.rng import stream  # noqa: E402

STUDY = [
    *("-m", "augment=safi", "reg=none,uar", "seed=0,1", "threads=1", "study=kill"),
    *("scene.width=96", "scene.height=72", "init.budget=1500", "trainer.evaluations=2"),
]
SMALL = [  # for the tests: two runs
    *("-m", "augment=safi", "reg=none,uar", "threads=1", "study=kill", "depth=ground_truth"),
    *("scene.width=64", "scene.height=48", "scene.supersampling=1", "init.budget=300"),
    *("trainer.evaluations=1",),
]
SMALL_COST_TIMES = 3  # short runs end before a checkpoint is due otherwise, on a quick machine
LAUNCHERS = {
    "basic": [],
    "joblib": ["hydra/launcher=joblib", "hydra.launcher.n_jobs=2"],
    "submitit_local": ["hydra/launcher=submitit_local"],
    "ray": ["hydra/launcher=ray", "+hydra.launcher.ray.init.num_cpus=2"],
}
CLOCK = "any moment"
BUSY, PATIENCE = 3, 30  # exit code where another process is at a run; times to ask again
WRITES = {  # what is being written -> its temporary file, relative to the study
    "a checkpoint": "runs/*/checkpoints/.step-*.tmp",
    "a render": "runs/*/renders/.*.tmp",
    "the Gaussians": "runs/*/.point_cloud.ply.*.tmp",
    "a table": "runs/*/.*.csv.*.tmp",
    "a record": "runs/*/.record.json.*.tmp",
    "the report or a figure": ".*.tmp",
}


@dataclass
class Tally:
    """Of a launcher and a capacity. killed: kills by target; caught: of those, how many left a
    half-written file. studies: completed, of them unequal to the undisturbed one. doubled, lost:
    runs. resumed: trainings that went on from a checkpoint."""

    launcher: str = ""
    capacity: str = ""
    killed: Counter[str] = field(default_factory=Counter)
    caught: Counter[str] = field(default_factory=Counter)
    studies: int = 0
    unequal: int = 0
    doubled: int = 0
    lost: int = 0
    resumed: int = 0

    def add(self, other: Tally) -> None:
        self.killed += other.killed
        self.caught += other.caught
        for name in ("studies", "unequal", "doubled", "lost", "resumed"):
            setattr(self, name, getattr(self, name) + getattr(other, name))

    @classmethod
    def from_json(cls, entry: dict[str, Any]) -> Tally:
        counts = {name: Counter(entry[name]) for name in ("killed", "caught")}
        return cls(**{**entry, **counts})


@dataclass
class Undisturbed:
    """What every study must equal, and how long it takes.

    digests, parameters: by capacity, of the first launcher that ran it. seconds: by launcher."""

    digests: dict[str, dict[str, str]] = field(default_factory=dict)
    parameters: dict[str, dict[str, str]] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)


def begin(folder: Path, words: list[str], inside: Callable[[], object] = lambda: None) -> int:
    """Give the command `words` in `folder`, in a process of its own, which calls `inside` first;
    returns its id."""
    child = os.fork()
    if child:
        return child
    os.setpgid(0, 0)
    os.chdir(folder)
    quiet = os.open(folder / "log.txt", os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    os.dup2(quiet, 1)
    os.dup2(quiet, 2)
    from framework.command import cli

    inside()
    os._exit(cli.main(words))


def ended(child: int, wait: bool = False) -> int | None:
    """The exit code of `child`, negative for a signal; None while it runs."""
    pid, status = os.waitpid(child, 0 if wait else os.WNOHANG)
    return None if pid == 0 else os.waitstatus_to_exitcode(status)


def attempt(folder: Path, words: list[str], target: str, delay_s: float) -> int:
    """Begin, kill at the target or after `delay_s`; returns the exit code (-9: killed)."""
    study, child = folder / "reports" / "kill", begin(folder, words)
    until = time.monotonic() + delay_s
    while (code := ended(child)) is None:
        due = (
            time.monotonic() >= until
            if target == CLOCK
            else time.monotonic() >= until and any(study.glob(WRITES[target]))
        )
        if due:
            os.kill(child, signal.SIGKILL)
            code = ended(child, wait=True)
            assert code is not None
            gone(child)
            return code
        soon = target != CLOCK and time.monotonic() >= until
        time.sleep(0.0005 if soon else 0.005)
    return code


def gone(group: int) -> None:
    """Wait until a killed launcher's workers have noticed."""
    for _ in range(200):
        alive = False
        for stat in Path("/proc").glob("[0-9]*/stat"):
            with contextlib.suppress(OSError):
                state, _, of_group = stat.read_text().rsplit(") ", 1)[1].split()[:3]
                alive = alive or (int(of_group) == group and state != "Z")
        if not alive:
            return
        time.sleep(0.05)


def records(study: Path) -> dict[str, tuple[int, int]]:
    """Which record files there are; one that was written again differs."""
    found = study.glob("runs/*/record.json")
    return {p.parent.name: (p.stat().st_ino, p.stat().st_mtime_ns) for p in found}


def one_study(
    folder: Path,
    words: list[str],
    targets: list[str],
    whole_s: float,
    late: float,
    tally: Tally,
    purpose: tuple[int, str],
) -> Path:
    """Kill and begin again until the study is complete; spends `targets` from the end. late: up to
    this share of the study's time a file may be written before its kind is waited for. purpose:
    seed and name of the moments that are drawn."""
    folder.mkdir()
    study, known, number = folder / "reports" / "kill", dict[str, tuple[int, int]](), 0
    while True:
        target = targets[-1] if targets else CLOCK
        draw = stream(purpose[0], purpose[1], number).random()
        number += 1
        wait_s = draw * whole_s * (0.6 if target == CLOCK else late) if targets else 1e9
        code = patiently(folder, words, target, wait_s)
        now = records(study)
        tally.doubled += sum(now[run] != record for run, record in known.items() if run in now)
        tally.lost += len(known.keys() - now.keys())
        known = now
        if code != -signal.SIGKILL:
            if code != 0:
                log = (folder / "log.txt").read_text()
                raise SystemExit(f"the study ended with {code}: {log}")
            return study
        targets.pop()
        tally.killed[target] += 1
        pattern = "**/.*.tmp" if target == CLOCK else WRITES[target]
        tally.caught[target] += any(study.glob(pattern))


def patiently(folder: Path, words: list[str], target: str, delay_s: float) -> int:
    """As `attempt`, but waits for the workers of a killed command that are still at a run."""
    for _ in range(PATIENCE):
        code = attempt(folder, words, target, delay_s)
        if code != BUSY:
            break
        time.sleep(2)
    return code


def undisturbed(tally: Tally, words: list[str], work: Path, known: Undisturbed) -> None:
    """Run the study once where its result, or the time of its launcher, is not known yet."""
    launcher, capacity = tally.launcher, tally.capacity
    if capacity in known.digests and launcher in known.seconds:
        return
    (work / "whole").mkdir()
    started = time.monotonic()
    code = ended(begin(work / "whole", words), wait=True)
    if code != 0:
        log = (work / "whole" / "log.txt").read_text()
        raise SystemExit(f"the undisturbed study ended with {code}: {log}")
    study = work / "whole" / "reports" / "kill"
    found = digests(study)
    if found != known.digests.setdefault(capacity, found):
        raise SystemExit(f"{launcher}, {capacity}: other bytes than by the first launcher")
    known.parameters.setdefault(capacity, parameters(study))
    known.seconds.setdefault(launcher, time.monotonic() - started)


def measure(
    tally: Tally,
    words: list[str],
    targets: list[str],
    late: float,
    work: Path,
    known: Undisturbed,
    seed: int,
) -> None:
    """All kills, the last of `targets` first, added to `tally`; a line per completed study."""
    undisturbed(tally, words, work, known)
    expected, whole_s = known.digests[tally.capacity], known.seconds[tally.launcher]
    hashes, kills = known.parameters[tally.capacity], len(targets)
    while targets:
        name, left = f"{tally.studies}", len(targets)
        purpose = seed, f"kill/{tally.launcher}/{tally.capacity}/{name}"
        started, attempts = time.monotonic(), len(targets)
        study = one_study(work / name, words, targets, whole_s, late, tally, purpose)
        if len(targets) == attempts:  # the machine is quicker now, and nothing was killed in time
            whole_s = min(whole_s, time.monotonic() - started)
        found = digests(study)
        differ = sorted(k for k in {*found, *expected} if found.get(k) != expected.get(k))
        equal = not differ and parameters(study) == hashes
        tally.studies += 1
        if targets and len(targets) == left:
            targets[-1] = CLOCK
        tally.unequal += not equal or bool(leftovers(study))
        tally.resumed += (work / name / "log.txt").read_text().count("going on at step")
        killed = sum(tally.killed.values())
        print(f"study {name}: {killed} of {kills} kills, equal: {equal}", *differ, flush=True)


def moments(kills: int) -> list[str]:
    """What to kill at: half of the times at random, else at each kind of file in turn."""
    names = list(WRITES)
    return [CLOCK if i % 2 == 0 else names[i // 2 % len(names)] for i in range(kills)][::-1]


def table(tallies: list[Tally], commands: list[str], runs: int) -> str:
    """By the moment of the kill, and by launcher and capacity where there are several."""
    total, by_pair = Tally(), dict[tuple[str, str], Tally]()
    for one in tallies:
        total.add(one)
        by_pair.setdefault((one.launcher, one.capacity), Tally()).add(one)
    lines = [*(f"`{command}`  " for command in commands[:-1]), f"`{commands[-1]}`", ""]
    lines += ["| killed by SIGKILL at | times | file found half-written |", "|---|---|---|"]
    for target in (CLOCK, *WRITES):
        lines.append(f"| {target} | {total.killed[target]} | {total.caught[target]} |")
    lines += [
        "",
        f"{sum(total.killed.values())} kills over {total.studies} studies of {runs} runs;"
        f" {total.resumed} trainings went on from a checkpoint."
        f" Studies that differ from the undisturbed one (parameters, metrics, renders, report):"
        f" {total.unequal}. Runs lost: {total.lost}. Runs done twice: {total.doubled}.",
    ]
    if len(by_pair) > 1:
        lines += [
            "",
            "| launcher | capacity | kills | studies | resumed | lost | doubled | changed |",
        ]
        lines += ["|---|---|---|---|---|---|---|---|"]
        for (launcher, capacity), one in by_pair.items():
            counts = sum(one.killed.values()), one.studies, one.resumed
            cells = launcher, capacity, *counts, one.lost, one.doubled, one.unequal
            lines.append(f"| {' | '.join(str(cell) for cell in cells)} |")
    return "\n".join(lines) + "\n"


def add_up(path: Path | None, command: str, tallies: list[Tally]) -> tuple[list[str], list[Tally]]:
    """These and those that earlier calls left in `path`, which then holds all; their commands."""
    calls = json.loads(path.read_text(encoding="utf-8")) if path and path.is_file() else []
    calls.append({"command": command, "tallies": [vars(one) for one in tallies]})
    if path:
        path.write_text(json.dumps(calls, indent=1), encoding="utf-8")
    read = [Tally.from_json(entry) for call in calls for entry in call["tallies"]]
    return [call["command"] for call in calls], read


def warm_up(work: Path, study: list[str]) -> None:
    """Import and compile in this process what its forks will need."""
    from framework.command import cli

    here = Path.cwd()
    work.mkdir()
    os.chdir(work)
    words = [word.replace("none,", "").replace("0,1", "0") for word in study[1:]]
    code = cli.main([*words, "trainer.steps=4"])
    os.chdir(here)
    if code != 0:
        raise SystemExit(code)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, help="52, or one at each kind of moment if --small")
    parser.add_argument("--steps", type=int, default=80)
    parser.add_argument("--seed", type=int, default=0, help="other moments")
    parser.add_argument("--output", type=Path)
    parser.add_argument("--counts", type=Path, help="a file in which several calls add up")
    parser.add_argument("--small", action="store_true")
    parser.add_argument("--capacities", default="evidence")
    parser.add_argument("--launchers", default="basic")
    given = parser.parse_args()
    study, late = (SMALL, 0.0) if given.small else (STUDY, 0.2)
    targets = moments(given.kills or 52)
    if given.small and given.kills is None:
        targets = [CLOCK, *WRITES][::-1]
    total = len(targets)
    pairs = list(product(given.launchers.split(","), given.capacities.split(",")))
    tallies, known = [Tally(*pair) for pair in pairs], Undisturbed()
    with tempfile.TemporaryDirectory() as folder:
        warm_up(Path(folder) / "warm", study)
        if given.small:
            from framework.train.resume import checkpoint

            checkpoint.COST_TIMES = SMALL_COST_TIMES
        for k, tally in enumerate(tallies):
            share = targets[k * total // len(pairs) : (k + 1) * total // len(pairs)]
            words = [*study, f"trainer.steps={given.steps}", *LAUNCHERS[tally.launcher]]
            words.append(f"capacity={tally.capacity}")
            work = Path(folder) / f"{tally.launcher}-{tally.capacity}"
            work.mkdir()
            print(f"{tally.launcher}, {tally.capacity}:", flush=True)
            measure(tally, words, share, late, work, known, given.seed)
    shown = "--small " * given.small + f"--kills {total} --steps {given.steps}"
    shown += f" --seed {given.seed}" if given.seed else ""
    command = f"python benchmarks/safety/kill.py {shown}"
    if len(pairs) > 1:
        command += f" --launchers {given.launchers} --capacities {given.capacities}"
    commands, every = add_up(given.counts, command, tallies)
    text = table(every, commands, 2 if given.small else 4)
    print(text)
    if given.output is not None:
        given.output.parent.mkdir(parents=True, exist_ok=True)
        given.output.write_text(text, encoding="utf-8")
    return int(any(one.unequal or one.lost or one.doubled for one in tallies))


if __name__ == "__main__":
    raise SystemExit(main())
