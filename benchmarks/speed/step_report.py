"""What `step.py` measured, as markdown tables."""

from __future__ import annotations

import os
import platform
import statistics
from dataclasses import dataclass

from framework.records.provenance import cpu_model

STAGES = {
    "project": "projection",
    "sort": "sort",
    "bin": "binning",
    "blend": "raster forward",
    "loss": "loss",
    "roughness": "smooth depth",
    "blend_backward": "raster backward",
    "update": "projection backward + Adam",
}

FREE = 1.9  # two processes that get this much more done than one alone have a core each


@dataclass(frozen=True)
class Steps:
    """What one process measured in a turn. stages: milliseconds of every step by key of
    STAGES. wall_ms, cpu_ms: of every whole step."""

    stages: dict[str, list[float]]
    wall_ms: list[float]
    cpu_ms: list[float]

    @property
    def wall(self) -> float:
        return statistics.median(self.wall_ms)


@dataclass(frozen=True)
class Turn:
    """Consecutive steps: with one thread, with two, with one again, and in two processes of one
    thread each at the same time. Each ratio uses separate steps of one thread.
    """

    one: Steps
    two: Steps
    again: Steps
    both: list[Steps]

    @property
    def speed_up(self) -> float:
        """Speed-up of two threads."""
        return self.one.wall / self.two.wall

    @property
    def gain(self) -> float:
        """How many steps two processes take while one takes one alone."""
        return sum(self.again.wall / steps.wall for steps in self.both)


@dataclass
class Results:
    """All rounds. ours: by (count, threads). turns: by count. prototype: (wall, CPU) ms per round,
    by (count, threads)."""

    ours: dict[tuple[int, int], list[Steps]]
    turns: dict[int, list[Turn]]
    prototype: dict[tuple[int, int], list[tuple[float, float]]]

    @property
    def n_steps(self) -> int:
        """Measured steps of every number of Gaussians and threads."""
        return sum(len(steps.wall_ms) for steps in next(iter(self.ours.values())))

    def wall(self, count: int, threads: int) -> float:
        return statistics.median(t for s in self.ours[count, threads] for t in s.wall_ms)

    def cpu(self, count: int, threads: int) -> float:
        """The mean, as the prototype reports it."""
        return statistics.fmean(t for s in self.ours[count, threads] for t in s.cpu_ms)

    def stage(self, count: int, threads: int, name: str) -> float:
        return statistics.median(t for s in self.ours[count, threads] for t in s.stages[name])

    def prototype_wall(self, count: int, threads: int) -> float:
        return statistics.median(wall for wall, _ in self.prototype[count, threads])

    def prototype_cpu(self, count: int, threads: int) -> float:
        return statistics.fmean(cpu for _, cpu in self.prototype[count, threads])


def _row(cells: list[object]) -> str:
    return "| " + " | ".join(f"{c:.1f}" if isinstance(c, float) else str(c) for c in cells) + " |"


def _table(header: list[str], rows: list[list[object]]) -> list[str]:
    return [_row(list(header)), "|" + "---:|" * len(header), *map(_row, rows)]


def stage_table(results: Results, clock: str) -> list[str]:
    """Milliseconds by stage, a row per number of Gaussians and threads."""
    header = ["Gaussians", "threads", *STAGES.values(), "rest", "**wall**", "CPU"]
    rows: list[list[object]] = []
    for count, threads in sorted(results.ours):
        stages = [results.stage(count, threads, name) for name in STAGES]
        wall = results.wall(count, threads)
        cpu = results.cpu(count, threads)
        rest = (wall if clock == "wall" else cpu) - sum(stages)
        rows.append([count, threads, *stages, rest, wall, cpu])
    return _table(header, rows)


def comparison_table(results: Results) -> list[str]:
    """Single-thread totals compared with the prototype's, and the gain of a second thread."""
    header = ["Gaussians", "ours, 1 thread", "prototype", "ratio of wall", "ratio of CPU"]
    header += ["ours, 2 threads", "speed-up (quartiles)", "of two processes"]
    header += [f"speed-up where that is {FREE} or more (turns)", "prototype's speed-up"]
    rows: list[list[object]] = []
    for count in sorted({c for c, _ in results.ours}):
        rows.append([count, *_compared(results, count), *_speed_up(results, count)])
    return _table(header, rows)


def _compared(results: Results, count: int) -> list[object]:
    if (count, 1) not in results.ours:
        return ["-"] * 4
    wall, cpu = results.wall(count, 1), results.cpu(count, 1)
    if (count, 1) not in results.prototype:
        return [wall, "-", "-", "-"]
    other, other_cpu = results.prototype_wall(count, 1), results.prototype_cpu(count, 1)
    return [wall, other, f"{wall / other:.2f}", f"{cpu / other_cpu:.2f}"]


def _quartiles(values: list[float]) -> str:
    low, middle, high = statistics.quantiles(values, n=4) if len(values) > 1 else values * 3
    return f"{middle:.2f} ({low:.2f} to {high:.2f})"


def _speed_up(results: Results, count: int) -> list[object]:
    if not {(count, 1), (count, 2)} <= results.ours.keys():
        return ["-"] * 5
    turns = results.turns[count]
    free = [turn.speed_up for turn in turns if turn.gain >= FREE]
    gains: list[object] = [results.wall(count, 2), _quartiles([turn.speed_up for turn in turns])]
    gains += [_quartiles([turn.gain for turn in turns])]
    gains += [f"{statistics.median(free):.2f} ({len(free)} of {len(turns)})" if free else "-"]
    if not {(count, 1), (count, 2)} <= results.prototype.keys():
        return [*gains, "-"]
    other = results.prototype_wall(count, 1) / results.prototype_wall(count, 2)
    return [*gains, f"{other:.2f}"]


def report(results: Results, command: str, clock: str) -> str:
    """The markdown that is printed and written."""
    lines = [
        "# One training step, milliseconds by stage",
        "",
        f"`{command}` on {cpu_model()} ({os.cpu_count()} cores), Python"
        f" {platform.python_version()}; 504x378, SH degree 3. Stages: medians over"
        f" {results.n_steps} steps in {clock} time; CPU: mean of the whole process.",
        "",
        *stage_table(results, clock),
        "",
        *comparison_table(results),
        "",
    ]
    return "\n".join(lines)
