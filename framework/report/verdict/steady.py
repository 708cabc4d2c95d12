"""Whose results agree better from seed to seed, and what the study could have found about it."""

from __future__ import annotations

from framework.report.statistics.numbers import p_text, significant, spanned
from framework.report.statistics.outcomes import Outcomes
from framework.report.statistics.variance import SigmaComparison

HARDLY = 0.1  # a test that finds no spread above this share of another's says next to nothing


def steady_sentence(found: Outcomes) -> str:
    """Which method's deviation over seeds (σ) differs from the baseline's; where none is shown to,
    what the test would have found 8 times in 10. "" where nothing was tested."""
    clear = [c for c in found.sigmas.values() if c.significant]
    steadier = [c for c in clear if c.steadier]
    looser = [c for c in clear if not c.steadier]
    said = f"Steadier from seed to seed: {_listed(steadier)}." if steadier else ""
    less = f"Less steady from seed to seed: {_listed(looser)}." if looser else ""
    if said or less or all(c.ratio is None for c in found.sigmas.values()):
        return " ".join(filter(None, (said, less)))
    return _nobody(found)


def _nobody(found: Outcomes) -> str:
    """What a study of so many seeds could have noticed, where it noticed nothing."""
    tested = [c for c in found.sigmas.values() if c.ratio is not None]
    c = min(tested, key=lambda c: c.detectable or 0.0)  # the least favourable
    seeds = f"{c.n} seeds" if c.n == c.other_n else f"{c.n} and {c.other_n} seeds"
    start = f"Steadier from seed to seed: nobody is shown to be. With {seeds}"
    if c.detectable is None:
        return f"{start} no difference in spread could have been noticed, however large."
    least = f"below {significant(c.detectable)} times that of {c.baseline}"
    if c.detectable < HARDLY:
        return (
            f"{start} that says next to nothing: only a spread (σ) {least} would be noticed 8 times"
            " in 10."
        )
    return f"{start} a spread (σ) had to be {least} to be noticed 8 times in 10."


def _listed(clear: list[SigmaComparison]) -> str:
    return "; ".join(map(_said, clear))


def _said(c: SigmaComparison) -> str:
    if c.ratio is None:
        how, does = ("not at all, and", "does") if c.steadier else ("and", "does not")
        return f"{c.method} varies {how} {c.baseline} {does} ({p_text(c.p_joint)})"
    inside = f" ({spanned(c.interval)})" if c.interval else ""
    return f"{c.method} has {significant(c.ratio)} times the spread (σ) of {c.baseline}{inside}"
