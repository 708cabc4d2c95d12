"""What every plugin costs: CPU time per training step relative to a step without any.

    python benchmarks/speed/every_plugin.py [--chunk 5] [--only a,b] [--output FILE] [OVERRIDE ...]

A row for every augmenter, regularizer and capacity that is registered, each alone with its defaults
beside `augment=none reg=none capacity=fixed`, and one for a plugin without any hook: what a plugin
that asks for nothing costs; then the trainer's own terms (`TERMS`). What begins later than these
few steps is told to begin at once (`EAGER`), and the row says so. The trainings are threads of one
process and take turns of `--chunk` steps, all others waiting, so that a slow minute hits all alike
and CPU ratios hold on a machine with other work. One thread, no evaluations, kernels compiled
before. A plugin that acts in a part of the training only (`start`, `stop`) costs more while it
acts. Initializers follow, once per run.
"""

from __future__ import annotations

import argparse
import os
import platform
import statistics
import sys
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from benchmarks.prepare import Prepared, prepared  # noqa: E402
from framework import registry  # noqa: E402
from framework.plugin import Regularizer, register  # noqa: E402

NOTHING = "asks_nothing"
DEFAULTS = ("scene.width=160", "scene.height=120", "trainer.steps=40", "trainer.members=1")
ALONE = {"augment": "none", "reg": "none", "capacity": "fixed"}
BASELINE = "without any plugin"
EAGER = {
    "adc": ("capacity.from_step=5", "capacity.every=10"),
    "sh_dropout": ("trainer.sh_degree=1",),
}
TERMS = "trainer.opacity_spare=0.5", "trainer.depth_smoothness=0"


@register("reg", NOTHING)
@dataclass(frozen=True)
class AsksNothing(Regularizer):
    """It is there, and has no hook."""


@dataclass
class Turns:
    """A `Progress` that lets its training go on for `chunk` steps at a time, when it is told."""

    chunk: int
    go: threading.Semaphore = field(default_factory=lambda: threading.Semaphore(0))
    came: threading.Semaphore = field(default_factory=lambda: threading.Semaphore(0))
    spent: list[float] = field(default_factory=list)  # CPU seconds of each turn
    began: float = 0.0
    gaussians: int = 0
    steps: int = 0
    over: bool = False
    error: BaseException | None = None

    def wait(self) -> None:
        """Block until it is our turn."""
        self.go.acquire()
        self.began = time.process_time()

    def step(
        self, step: int, n_steps: int, loss: float, gaussians: int, psnr: float | None = None
    ) -> None:
        if step % self.chunk == 0 or step == n_steps:
            self.spent.append(time.process_time() - self.began)
            self.gaussians, self.steps, self.over = gaussians, step, step == n_steps
            if not self.over:
                self.came.release()
                self.wait()

    def stage(self, what: str) -> None: ...

    def compiling(self, what: str) -> None: ...

    def note(self, text: str) -> None: ...

    def done(self, text: str) -> None: ...


def started(ready: Prepared, chunk: int) -> Turns:
    """A training in a thread of its own, waiting for its first turn."""
    turns = Turns(chunk)

    def work() -> None:
        try:
            trainer = ready.trainer(turns)
            turns.came.release()
            turns.wait()
            trainer.run()
        except BaseException as error:  # told by who takes turns
            turns.error = error
        turns.over = True
        turns.came.release()

    threading.Thread(target=work, daemon=True).start()
    turns.came.acquire()
    return turns


def rows(only: Sequence[str]) -> list[tuple[str, str]]:
    """(group, name) of all that is measured."""
    found = [(group, name) for group in registry.GROUPS for name in sorted(registry.table(group))]
    chosen = [pair for pair in found if pair[1] != ALONE[pair[0]]]
    return [pair for pair in chosen if not only or pair[1] in only or pair[1] == NOTHING]


def _beside(only: Sequence[str]) -> list[tuple[str, tuple[str, ...]]]:
    """(how the row is called, what it changes) of every plugin and term."""
    found = [
        (f"{group}={name}", (f"{group}={name}", *EAGER.get(name, ()))) for group, name in rows(only)
    ]
    terms = [] if only else [(term, (term,)) for term in TERMS]
    return [(", ".join((label, *changes[1:])), changes) for label, changes in [*found, *terms]]


def measured(overrides: Sequence[str], chunk: int, only: Sequence[str]) -> list[tuple[str, Turns]]:
    """(name, its turns) of the baseline and of every plugin."""
    from framework.compute import parallel

    parallel.set_threads(1)
    all_of: list[tuple[str, Turns]] = []
    for label, changes in [(BASELINE, ()), *_beside(only)]:
        chosen = [f"{group}={name}" for group, name in ALONE.items()]
        groups = {change.partition("=")[0] for change in changes}
        kept = [word for word in chosen if word.partition("=")[0] not in groups]
        words = [*DEFAULTS, *kept, *changes, *overrides]
        all_of.append((label, started(prepared(words), chunk)))
        print(f"ready: {label}", file=sys.stderr)
    while not all(turns.over for _, turns in all_of):
        for name, turns in all_of:
            if not turns.over:
                turns.go.release()
                turns.came.acquire()
                if turns.error is not None:
                    raise SystemExit(f"error: {name}: {turns.error}")
    return all_of


def starts(overrides: Sequence[str]) -> list[str]:
    """A line per initializer: CPU milliseconds of one build, and Gaussians."""
    lines = []
    ready = prepared([*DEFAULTS, *overrides])
    for name, cls in sorted(registry.table("init").items()):
        build = cls().build
        known = ready.scene.training, ready.depth, 0, 0
        build(*known)
        began = time.process_time()
        n = len(build(*known))
        lines.append(f"| {name} | {1e3 * (time.process_time() - began):.0f} | {n:,} |")
    return lines


def report(found: list[tuple[str, Turns]], begun: list[str], command: str) -> str:
    """The markdown that is printed and written."""
    from framework.records.provenance import cpu_model

    base = found[0][1]
    lines = [
        "# What every plugin costs",
        "",
        f"`{command}` on {cpu_model()} ({os.cpu_count()} cores, one used, other programs beside),"
        f" Python {platform.python_version()}: CPU milliseconds per step, and the ratio to a step"
        f" without any plugin, over {base.steps} steps that all took in turns.",
        "",
        "| plugin | CPU ms a step | ratio | in its slowest turn | Gaussians in the end |",
        "|---|---:|---:|---:|---:|",
    ]
    for name, turns in found:
        ratios = [own / plain for own, plain in zip(turns.spent, base.spent, strict=True)]
        per_step = 1e3 * sum(turns.spent) / turns.steps
        whole = sum(turns.spent) / sum(base.spent)
        lines.append(
            f"| {name} | {per_step:.1f} | {whole:.2f} | {max(ratios):.1f} | {turns.gaussians:,} |"
        )
    nothing = dict(found).get(f"reg={NOTHING}")
    if nothing is not None:
        ratios = [own / plain for own, plain in zip(nothing.spent, base.spent, strict=True)]
        low, high = sorted(ratios)[len(ratios) // 4], sorted(ratios)[-1 - len(ratios) // 4]
        lines += [
            "",
            f"A plugin that asks for nothing: {statistics.median(ratios):.2f} times a step without"
            f" it, median over the turns (quartiles {low:.2f} and {high:.2f}).",
        ]
    lines += ["", "Initializers, once per run:", "", "| init | CPU ms | Gaussians |"]
    return "\n".join([*lines, "|---|---:|---:|", *begun, ""])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("overrides", nargs="*", metavar="OVERRIDE", default=[])
    parser.add_argument("--chunk", type=int, default=5, help="steps per turn")
    parser.add_argument("--only", default="", help="names of plugins, joined by commas")
    parser.add_argument("--output", type=Path)
    args = parser.parse_intermixed_args()
    only = [name for name in args.only.split(",") if name]
    found = measured(args.overrides, args.chunk, only)
    words = ["python benchmarks/speed/every_plugin.py", *args.overrides]
    text = report(found, starts(args.overrides), " ".join(words))
    print(text)
    if args.output is not None:
        args.output.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
