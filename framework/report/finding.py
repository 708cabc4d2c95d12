"""The one sentence of finding. It claims a difference only where the paired test supports it, and
says so where a single run supports nothing."""

from __future__ import annotations

from framework.report.collect import Study
from framework.report.outcomes import Outcomes
from framework.report.statistics import Comparison, Interval, Spread


def sentence(study: Study, found: Outcomes) -> str:
    """What the study found, in plain words."""
    if not study.runs:
        return "No run of this study finished."
    if not found.psnr:
        return "No method of this study finished on every scene with a finite PSNR."
    if len(found.psnr) == 1:
        ((method, only),) = found.psnr.items()
        return f"On {_where(study)}, {method} reaches {_level(only)}."
    best = max(found.psnr, key=lambda method: found.psnr[method].mean)
    if best == study.baseline:
        rivals = [m for m in found.psnr if m != best]
        rival = max(rivals, key=lambda method: found.psnr[method].mean)
        comparison = found.comparisons.get(rival)
    else:
        rival, comparison = study.baseline, found.comparisons.get(best)
    reach = f"{best} reaches {found.psnr[best].mean:.2f} dB"
    if comparison is None:
        return f"On {_where(study)}, {reach}; it shares no seed with {rival}, so no comparison."
    return _compared(study, reach, rival, comparison, len(found.comparisons))


def p_text(p: float) -> str:
    """`p = 0.012`, or `p < 0.001`."""
    return "p < 0.001" if p < 0.001 else f"p = {p:.2g}"


def interval_text(interval: Interval, digits: int = 2) -> str:
    """`0.21 to 0.60`."""
    return f"{interval.low:.{digits}f} to {interval.high:.{digits}f}"


def _compared(study: Study, reach: str, rival: str, c: Comparison, tests: int) -> str:
    side = "above" if rival == c.baseline else "below"
    margin = f"{abs(c.difference):.2f} dB {_direction(c, rival)} {rival}"
    if c.interval is None or c.p_holm is None:
        return (
            f"On {_where(study)}, {reach}, {margin} in a single paired run: nothing can be said"
            " about stability, nor whether the difference exceeds the noise of the seed."
        )
    # the interval is of method minus baseline; seen from the best method its sign may turn
    shown = c.interval if side == "above" else Interval(-c.interval.high, -c.interval.low)
    correction = f", Holm-corrected for {tests} comparisons" if tests > 1 else ""
    evidence = (
        f"95 % interval {interval_text(shown)}, n = {c.n} {_pairs(study)},"
        f" {p_text(c.p_holm)}{correction}"
    )
    if c.significant:
        return f"On {_where(study)}, {reach}, {margin} ({evidence})."
    return f"On {_where(study)}, {reach}, {margin}: no significant difference ({evidence})."


def _direction(c: Comparison, rival: str) -> str:
    gain = c.difference if rival == c.baseline else -c.difference
    return "above" if gain >= 0 else "below"


def _level(only: Spread) -> str:
    if only.mean_interval is None or only.sd is None:
        return (
            f"{only.mean:.2f} dB in a single run (n = 1): nothing can be said about its stability"
        )
    return (
        f"{only.mean:.2f} dB (95 % interval {interval_text(only.mean_interval)}, n = {only.n}"
        f" seeds, σ_PSNR {only.sd:.3f} dB)"
    )


def _where(study: Study) -> str:
    return study.scenes[0] if len(study.scenes) == 1 else f"{len(study.scenes)} scenes"


def _pairs(study: Study) -> str:
    return "seeds, paired" if len(study.scenes) == 1 else "pairs of scene and seed"
