"""What a measurement is: a number, or why there is none. Light to import: reports read these."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from framework.errors import nearest_hint, require

# what every run measures; `MEASURES` has the plugins that `metrics.also` chooses among
METRICS = ("psnr", "ssim", "flip", "lpips", "lpips_01")
LOWER = ("flip", "lpips", "lpips_01")  # of these less is better
# of some runs: the mean of errors where there is LPIPS, score and rank where they are asked for
AVERAGE, COADAPTATION, RANK = "avge", "coadaptation", "effective_rank"
LARGEST = 1e15  # of a number in a record or a table: reports square and sum them
MEASURES: dict[str, type] = {}
RESERVED = (
    *METRICS,
    AVERAGE,
    COADAPTATION,
    RANK,
    "view",
    "tags",
    "render_s",
    "file",
    "missing",
)  # columns of metrics.csv


def digits(metric: str) -> int:
    """Decimal places that a table shows of a metric."""
    return 2 if metric == "psnr" else 4


@dataclass(frozen=True)
class Missing:
    """A value that does not exist, and why."""

    reason: str


Measurement = float | Missing


@dataclass(frozen=True)
class ViewMetrics:
    """One test view: psnr in dB, ssim, flip, lpips, lpips_01, each or why missing; render_s
    in s; also: by name what plugins measured, AVGE and the co-adaptation score."""

    view: str
    tags: tuple[str, ...]
    psnr: Measurement
    ssim: Measurement
    flip: Measurement
    lpips: Measurement
    lpips_01: Measurement
    render_s: float
    also: Mapping[str, Measurement] = field(default_factory=dict)

    def value(self, metric: str) -> Measurement:
        """The measurement named `metric`, one of `METRICS` or of `also`."""
        return self.also[metric] if metric in self.also else getattr(self, metric)


def measures(chosen: str | None) -> list[str]:
    """The names in `metrics.also`, in their order. UserError for an unknown or repeated one."""
    names = [] if chosen is None else chosen.split("+")
    for name in names:
        require(name in MEASURES, f"metrics.also: unknown metric '{name}'; {_available(name)}")
        require(
            names.count(name) == 1,
            f"metrics.also: expected each metric once, got {name} twice; drop one",
        )
    return names


def _available(name: str) -> str:
    """What there is to measure; `name` is none of it, or needs no asking for."""
    measured = f"every run measures {', '.join(METRICS)}"
    if not MEASURES:
        return f"{measured}, and no plugin more; leave it out"
    return f"{nearest_hint(name, MEASURES)}, several are joined by +; {measured} anyway"
