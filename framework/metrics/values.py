"""What a measurement is: a number, or the reason why there is none. Light, as reports import it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TypeVar

from framework.errors import nearest_hint, require

T = TypeVar("T")
METRICS = ("psnr", "ssim", "flip", "lpips", "lpips_01")  # columns of every run
LOWER = ("flip", "lpips", "lpips_01")  # lower is better
# of some runs: the mean error where LPIPS was measured, the other two on request
AVERAGE, COADAPTATION, RANK = "avge", "coadaptation", "effective_rank"
LPIPS_BOTH, VIEWS = "lpips_both", "views"  # options of `metrics`
LARGEST = 1e15  # of a number in a record or a table: reports square and sum them
MEASURES: dict[str, type] = {}  # plugins that `metrics.also` chooses from
# columns of metrics.csv
RESERVED = (*METRICS, AVERAGE, COADAPTATION, RANK, "view", "tags", "render_s", "file", "missing")


def digits(metric: str) -> int:
    """Decimal places of a metric in tables."""
    return 2 if metric == "psnr" else 4


@dataclass(frozen=True)
class Missing:
    """A value that does not exist, and why."""

    reason: str


Measurement = float | Missing
NOT_REQUESTED = Missing("not measured; metrics.lpips_both=true measures it")


@dataclass(frozen=True)
class ViewMetrics:
    """The metrics of one test view.

    Attributes:
        psnr: in dB; this and the next four may be Missing.
        render_s: seconds that rendering took.
        also: further metrics by name: AVGE, co-adaptation and those of plugins.
    """

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


def evenly(views: Sequence[T], n: int) -> tuple[T, ...]:
    """At most `n` of the views, evenly spaced; all of them if n is 0."""
    if n == 0 or len(views) <= n:
        return tuple(views)
    return tuple(views[(2 * i + 1) * len(views) // (2 * n)] for i in range(n))


def measures(chosen: str | None) -> list[str]:
    """The names in `metrics.also`, in their order.

    Raises:
        UserError: a name is unknown or repeated.
    """
    names = [] if chosen is None else chosen.split("+")
    for name in names:
        require(name in MEASURES, f"metrics.also: unknown metric '{name}'; {_available(name)}")
        require(
            names.count(name) == 1,
            f"metrics.also: expected each metric once, got {name} twice; drop one",
        )
    return names


def _available(name: str) -> str:
    always = f"every run measures {', '.join(METRICS)}"
    if not MEASURES:
        return f"{always}, and no plugin adds a metric; leave it out"
    return f"{nearest_hint(name, MEASURES)}, several are joined by +; {always} anyway"
