"""Whose results agree better from seed to seed, and what the study could have found about it."""

from __future__ import annotations

from framework.report.statistics.numbers import significant, spanned
from framework.report.statistics.outcomes import Outcomes
from framework.report.statistics.variance import SigmaComparison


def steady_sentence(found: Outcomes) -> str:
    """Which method's deviation over seeds (σ) differs from the baseline's; where none is shown to,
    the ratio that the test would have found 8 times in 10. "" where nothing was tested."""
    tested = [c for c in found.sigmas.values() if c.ratio is not None]
    if not tested:
        return ""
    steadier = [c for c in tested if c.significant and (c.ratio or 0) < 1]
    looser = [c for c in tested if c.significant and (c.ratio or 0) > 1]
    said = f"Steadier: {_listed(steadier) if steadier else f'nobody shown ({power(found)})'}"
    return f"{said}{f'. Less steady: {_listed(looser)}' if looser else ''}."


def power(found: Outcomes) -> str:
    """`10 seeds would have found a ratio of 0.35`."""
    c = min(found.sigmas.values(), key=lambda c: (min(c.n, c.other_n), max(c.n, c.other_n)))
    seeds = f"{c.n} seeds" if c.n == c.other_n else f"{c.n} and {c.other_n} seeds"
    if c.detectable is None:
        return f"{seeds} are too few to find any ratio of σ"
    return f"{seeds} would have found a σ of {significant(c.detectable)} times that of {c.baseline}"


def _listed(clear: list[SigmaComparison]) -> str:
    return "; ".join(
        f"{c.method} has {significant(c.ratio or 0)} times the σ of {c.baseline}"
        + (f" ({spanned(c.interval)})" if c.interval else "")
        for c in clear
    )
