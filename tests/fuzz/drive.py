"""Starts the worker, again after each case it died of, and counts the outcomes."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from framework.command.config.schema import ROOT

# A case may take the worker's own 60 s by the clock; only one that stops those clocks, too, writes
# nothing for so long. Nothing limits the whole, so that any number of cases comes to an end.
SILENT_S = 300.0


@dataclass
class Tally:
    """counts: reader -> outcome (`read`, `refused`, `bug`) -> number. bugs: what was not right.
    special: how many cases had something in the file's place that is no file. slowest_s: reader ->
    CPU seconds of its slowest case."""

    counts: dict[str, Counter[str]] = field(default_factory=dict)
    bugs: list[str] = field(default_factory=list)
    special: int = 0
    slowest_s: dict[str, float] = field(default_factory=dict)

    @property
    def cases(self) -> int:
        return sum(sum(counter.values()) for counter in self.counts.values())

    def add(self, reader: str, index: int, outcome: str, cpu_s: float) -> None:
        self.slowest_s[reader] = max(cpu_s, self.slowest_s.get(reader, 0.0))
        kind = outcome if outcome in ("read", "refused") else "bug"
        self.counts.setdefault(reader, Counter())[kind] += 1
        if kind == "bug":
            self.bugs.append(f"{reader} {index}: {outcome}")


def fuzz(results: Path, readers: Sequence[str], cases: int, seed: int) -> Tally:
    """`cases` mutated inputs of each reader; `results` is a file for the worker's notes."""
    tally = Tally()
    waiting = [(list(readers), 0)]
    while waiting:
        names, first = waiting.pop(0)
        results.write_text("", encoding="utf-8")
        command = [sys.executable, "-m", "tests.fuzz.worker", str(results), str(seed)]
        code = watched([*command, str(first), str(cases), *names], results)
        died = _note(results, tally)
        if code != 0 and died is None:
            raise RuntimeError(f"the worker ended with {code} before its first case")
        if died is not None:
            name, index = died
            tally.add(name, index, _how(code), 0.0)
            rest = names[names.index(name) + 1 :]
            waiting += [([name], index + 1)] if index + 1 < cases else []
            waiting += [(rest, 0)] if rest else []
    return tally


def watched(command: list[str], results: Path, silent_s: float = SILENT_S) -> int:
    """The exit code of the worker, which is killed when it notes nothing for `silent_s`."""
    worker = subprocess.Popen(command, cwd=ROOT)
    size = -1
    while True:
        try:
            return worker.wait(silent_s)
        except subprocess.TimeoutExpired:
            if results.stat().st_size == size:
                worker.kill()
                return worker.wait()
            size = results.stat().st_size


def _note(results: Path, tally: Tally) -> tuple[str, int] | None:
    """Add the outcomes to `tally`; the case that was begun and has none."""
    begun: tuple[str, int] | None = None
    for line in results.read_text(encoding="utf-8").splitlines():
        entry = json.loads(line)
        if "outcome" in entry:
            assert begun is not None, "an outcome follows its case"
            tally.add(*begun, entry["outcome"], entry["cpu_s"])
            begun = None
        else:
            begun = entry["reader"], entry["index"]
            tally.special += entry["special"]
    return begun


def _how(code: int) -> str:
    if code == -signal.SIGALRM:
        return "hang: waits for more than 60 s"
    if code == -signal.SIGKILL:
        return f"hang: notes nothing for {SILENT_S:.0f} s (or killed for memory)"
    if code == -signal.SIGPROF:
        return "hang: more than 5 s of CPU time"
    return f"crash: {signal.Signals(-code).name if code < 0 else f'exit code {code}'}"
