"""Numbers as text, with as many digits as their uncertainty supports: it is shown with two
significant digits, and the number to the same decimal place."""

import math
from collections.abc import Sequence

import numpy as np

from framework.report.statistics.estimates import Interval, estimate

ABSENT = "–"
NOUGHT = 1e-9  # what rounding leaves of a zero
UNBOUNDED = 1e4  # times its low end: an interval whose high end says nothing


def decimals(uncertainty: float, most: int) -> int:
    """Decimal places that give `uncertainty` two significant digits; `most` where it is 0."""
    if not (uncertainty > 0 and math.isfinite(uncertainty)):
        return most
    return min(most, max(0, 1 - math.floor(math.log10(uncertainty))))


def format_significant(value: float, digits: int = 2) -> str:
    """`value` with so many significant digits, without an exponent."""
    if value == 0 or not math.isfinite(value):
        return f"{value:g}"
    places = digits - 1 - math.floor(math.log10(abs(value)))
    return f"{round(value, places):.{max(0, places)}f}"


def format_mean(values: Sequence[float | None], most: int, show_half: bool = False) -> str:
    """The mean, rounded by the half width of its 95 % interval, with it if `show_half`; `–`
    unless there are values and none is missing."""
    present = [value for value in values if value is not None]
    if not present or len(present) < len(values):
        return ABSENT
    summary = estimate(present)
    interval = summary.interval()
    if interval is None:
        return f"{summary.mean:.{most}f}"
    half = (interval.high - interval.low) / 2
    places = decimals(half, most)
    if show_half and half > 0:
        return f"{summary.mean:.{places}f} ± {half:.{places}f}"
    return f"{summary.mean:.{places}f}"


def format_sigma(values: Sequence[float]) -> str:
    """`0.16 [0.084 to 1.0] (n = 3)`."""
    if len(values) == 0:
        return ABSENT
    summary = estimate(values)
    if summary.sd is None or summary.sd_interval is None:
        return f"{ABSENT} (n = 1)"
    return (
        f"{format_significant(summary.sd)} [{format_span(summary.sd_interval)}] (n = {summary.n})"
    )


def format_span(interval: Interval) -> str:
    """An interval of a positive quantity: `0.084 to 1.0`; `0.084 or more` where the data bound it
    from one side alone."""
    if interval.high > UNBOUNDED * interval.low:
        return f"{format_significant(interval.low)} or more"
    return f"{format_significant(interval.low)} to {format_significant(interval.high)}"


def format_interval(interval: Interval) -> str:
    """`0.21 to 0.60`, rounded by its own width, at most to two decimals; an end that rounds to
    zero and is none gets more, so that its side is seen."""
    places = decimals((interval.high - interval.low) / 2, 2)
    ends = (0.0 if abs(end) < NOUGHT else end for end in (interval.low, interval.high))
    low, high = (
        f"{end:.{places}f}" if end == 0 or round(end, places) != 0 else format_significant(end, 1)
        for end in ends
    )
    return f"{low} to {high}"


def format_p(p: float) -> str:
    """`p = 0.012`, or `p < 0.001`."""
    return "p < 0.001" if p < 0.001 else f"p = {p:.2g}"


def format_difference(difference: float) -> str:
    """Format a difference in dB, the same in verdicts, tables and LaTeX: `+0.21`.

    One that would round to zero gets up to two more decimals, so that it keeps its sign; below
    these it is `0.00`, without one.
    """
    texts = (f"{difference:+.{places}f}" for places in (2, 3, 4))
    return next((text for text in texts if float(text) != 0), "0.00")


def average(values: Sequence[float | None]) -> float | None:
    """The mean; None unless there are values and none is missing."""
    present = [value for value in values if value is not None]
    return float(np.mean(present)) if present and len(present) == len(values) else None
