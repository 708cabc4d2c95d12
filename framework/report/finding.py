"""The one sentence of finding. It claims a difference only where the paired test supports it, and
says so where a single run supports nothing."""

from __future__ import annotations

from framework.report.collect import Study
from framework.report.numbers import decimals, interval_text, p_text, significant, spanned
from framework.report.outcomes import Outcomes
from framework.report.statistics import Comparison, Interval, Spread
from framework.report.variance import SigmaComparison


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
    base = study.baseline_of(best)
    if best == base:
        rivals = [m for m in found.psnr if study.baseline_of(m) == best and m != best]
        if not rivals:
            return f"On {_where(study)}, {best} reaches {_level(found.psnr[best])}."
        rival = max(rivals, key=lambda method: found.psnr[method].mean)
        comparison = found.comparisons.get(rival)
    else:
        rival, comparison = base, found.comparisons.get(best)
    reach = f"{best} reaches {found.psnr[best].mean:.{_places(found.psnr[best])}f} dB"
    if comparison is None:
        return f"On {_where(study)}, {reach}; it shares no seed with {rival}, so no comparison."
    return _compared(study, reach, rival, comparison, len(found.comparisons))


def stability_sentence(study: Study, found: Outcomes) -> str | None:
    """Whether a method's runs agree better than the baseline's; None where nothing was tested."""
    tested = [c for c in found.sigmas.values() if c.ratio is not None]
    if not tested:
        return None
    clear = [c for c in tested if c.significant]
    if clear:
        told = "; ".join(
            f"{c.method} {significant(c.ratio or 0)} times that of {c.baseline}"
            f" ({_p(c)}, 95 % interval {spanned(c.interval)})"
            for c in clear
            if c.interval is not None
        )
        return f"σ_PSNR differs: {told} (Brown–Forsythe{_holm(len(found.sigmas))})."
    lowest = min(tested, key=lambda c: c.ratio or 0)
    seeds = "" if lowest.seeds is None else f"; about {lowest.seeds} seeds each would tell it"
    return (
        f"σ_PSNR: no significant difference between the methods (Brown–Forsythe"
        f"{_holm(len(found.sigmas))}). The lowest is {lowest.method} with"
        f" {significant(lowest.ratio or 0)} times that of {lowest.baseline} ({_p(lowest)}{seeds})."
    )


def _p(c: SigmaComparison) -> str:
    return p_text(c.p if c.p_holm is None else c.p_holm)


def _holm(tests: int) -> str:
    return f", Holm-corrected for {tests} comparisons" if tests > 1 else ""


def _compared(study: Study, reach: str, rival: str, c: Comparison, tests: int) -> str:
    side = "above" if rival == c.baseline else "below"
    half = 0.0 if c.interval is None else (c.interval.high - c.interval.low) / 2
    margin = f"{abs(c.difference):.{decimals(half, 2)}f} dB {_direction(c, rival)} {rival}"
    if c.interval is None or c.p_holm is None:
        return (
            f"On {_where(study)}, {reach}, {margin} in a single paired run: nothing can be said"
            " about stability, nor whether the difference exceeds the noise of the seed."
        )
    # the interval is of method minus baseline; seen from the best method its sign may turn
    shown = c.interval if side == "above" else Interval(-c.interval.high, -c.interval.low)
    evidence = (
        f"95 % interval {interval_text(shown)}, n = {c.n} {_pairs(study)},"
        f" {p_text(c.p_holm)}{_holm(tests)}"
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
        f"{only.mean:.{_places(only)}f} dB (95 % interval {interval_text(only.mean_interval)}, n ="
        f" {only.n} seeds, σ_PSNR {significant(only.sd)} dB)"
    )


def _places(found: Spread) -> int:
    interval = found.mean_interval
    return 2 if interval is None else decimals((interval.high - interval.low) / 2, 2)


def _where(study: Study) -> str:
    return study.scenes[0] if len(study.scenes) == 1 else f"{len(study.scenes)} scenes"


def _pairs(study: Study) -> str:
    return "seeds, paired" if len(study.scenes) == 1 else "pairs of scene and seed"
