"""The sentences of finding: which method, by how much, how reliably, at what cost. They claim a
difference only where the paired test supports it, and say so where a single run supports nothing.
"""

from __future__ import annotations

from dataclasses import replace

from framework.report.statistics.estimates import Comparison, Interval, Spread, compare, holm
from framework.report.statistics.numbers import (
    decimals,
    interval_text,
    mean_text,
    p_text,
    significant,
    spanned,
)
from framework.report.statistics.outcomes import Outcomes, by_pair
from framework.report.statistics.variance import SigmaComparison
from framework.report.study.collect import Study


def sentences(study: Study, found: Outcomes) -> list[str]:
    """All that the first screen says of a study without a stress or budgets, in plain words."""
    told = [
        sentence(study, found),
        equals_sentence(study, found),
        stability_sentence(found),
        cost_sentence(study, found),
    ]
    return [text for text in told if text is not None]


def sentence(study: Study, found: Outcomes) -> str:
    """Which method has the highest mean PSNR, and how it compares with the baseline."""
    if not study.runs:
        return "No run of this study finished."
    if not found.psnr:
        return "No method of this study finished on every scene with a finite PSNR."
    best = _best(found)
    rival = _rival(study, found)
    if rival is None:
        return f"On {_where(study)}, {best} reaches {_level(found.psnr[best])}."
    base = study.baseline_of(best)
    comparison = found.comparisons.get(best if rival == base else rival)
    reach = f"{best} reaches {found.psnr[best].mean:.{_places(found.psnr[best])}f} dB"
    if comparison is None:
        return f"On {_where(study)}, {reach}; it shares no seed with {rival}, so no comparison."
    seen = comparison if rival == base else _turned(comparison)
    return f"On {_where(study)}, {reach}, {_compared(study, rival, seen, len(found.comparisons))}"


def equals_sentence(study: Study, found: Outcomes) -> str | None:
    """Which other methods the paired test does not tell from the best one; None if there is none
    that `sentence` has not named, or nothing was tested."""
    if len(found.psnr) < 3:
        return None
    best, rival = _best(found), _rival(study, found)
    values = {method: by_pair(study.of(method=method)) for method in found.psnr}
    tested = {
        method: c
        for method in found.psnr
        if method != best
        and (c := compare(method, values[method], best, values[best])) is not None
        and c.p is not None
    }
    p_holm = holm([c.p or 0.0 for c in tested.values()])
    corrected = [replace(c, p_holm=p) for c, p in zip(tested.values(), p_holm, strict=True)]
    alike = [c for c in corrected if not c.significant and c.method != rival]
    if not alike:
        return None
    listed = ", ".join(f"{c.method} ({_amount(c)})" for c in alike)
    return f"Not significantly different from {best}: {listed}; paired{_holm(len(tested))}."


def stability_sentence(found: Outcomes) -> str | None:
    """Whether a method's runs agree better than the baseline's; None where nothing was tested."""
    tested = [c for c in found.sigmas.values() if c.ratio is not None]
    if not tested:
        return None
    clear = [c for c in tested if c.significant]
    test = f"Brown–Forsythe{_holm(len(found.sigmas))}"
    if clear:
        listed = "; ".join(_sigma_ratio(c) for c in clear)
        return f"σ_PSNR over seeds differs significantly: {listed} ({test})."
    same = f"σ_PSNR over seeds: no significant difference from {tested[0].baseline} ({test})"
    if len(tested) == 1:
        (only,) = tested
        return f"{same}. Observed ratio: {_observed(only)}."
    low, high = (pick(tested, key=lambda c: c.ratio or 0) for pick in (min, max))
    return f"{same}. Observed ratios: from {_observed(low)} to {_observed(high)}."


def cost_sentence(study: Study, found: Outcomes) -> str | None:
    """Training time and Gaussians of the best method beside those of what it is compared with."""
    if not found.psnr:
        return None
    best, rival = _best(found), _rival(study, found)
    methods = [best] if rival is None else [best, rival]
    told = ", ".join(_cost(study, method) for method in methods)
    return f"Cost: {told} (seconds of training by the wall clock and of CPU, mean over runs)."


def _best(found: Outcomes) -> str:
    return max(found.psnr, key=lambda method: found.psnr[method].mean)


def _rival(study: Study, found: Outcomes) -> str | None:
    """What the best method is compared with: its baseline; if it is that itself, the next best."""
    best = _best(found)
    base = study.baseline_of(best)
    if best != base:
        return base
    others = [m for m in found.psnr if m != best and study.baseline_of(m) == best]
    return max(others, key=lambda method: found.psnr[method].mean) if others else None


def _turned(c: Comparison) -> Comparison:
    """Seen from the other side: baseline minus method."""
    interval = c.interval and Interval(-c.interval.high, -c.interval.low)
    return replace(c, difference=-c.difference, interval=interval)


def _compared(study: Study, rival: str, c: Comparison, tests: int) -> str:
    if c.interval is None or c.p_holm is None:
        return (
            f"{_amount(c)} {rival} in a single paired run: nothing can be said about stability, nor"
            " whether the difference exceeds the noise of the seed."
        )
    if c.interval.low == c.interval.high == 0:
        return f"exactly as much as {rival} (equal in all of {c.n} pairs)."
    evidence = (
        f"95 % interval {interval_text(c.interval)}, n = {c.n} {_pairs(study)},"
        f" {p_text(c.p_holm)}{_holm(tests)}"
    )
    verdict = "" if c.significant else ": no significant difference"
    return f"{_amount(c)} {rival}{verdict} ({evidence})."


def _amount(c: Comparison) -> str:
    """`0.21 dB above`; what rounds to nothing is called less than the last digit shown."""
    half = 0.0 if c.interval is None else (c.interval.high - c.interval.low) / 2
    places = decimals(half, 2)
    side = "above" if c.difference >= 0 else "below"
    if round(abs(c.difference), places) == 0:
        return f"less than {10**-places:.{places}f} dB {side}"
    return f"{abs(c.difference):.{places}f} dB {side}"


def _sigma_ratio(c: SigmaComparison) -> str:
    inside = "" if c.interval is None else f", 95 % interval {spanned(c.interval)}"
    return (
        f"{c.method} has {significant(c.ratio or 0)} times that of {c.baseline} ({_p(c)}{inside})"
    )


def _observed(c: SigmaComparison) -> str:
    seeds = "" if c.seeds is None else f"; confirming it takes about {c.seeds} seeds each"
    return f"{significant(c.ratio or 0)} ({c.method}; {_p(c)}{seeds})"


def _cost(study: Study, method: str) -> str:
    runs = study.of(method=method)
    seconds = mean_text([run.record.train_s for run in runs], 1)
    cpu = mean_text([run.record.train_cpu_s for run in runs], 1)
    gaussians = mean_text([float(run.record.gaussians) for run in runs], 0)
    return f"{method} {seconds} s ({cpu} s of CPU) and {gaussians} Gaussians"


def _p(c: SigmaComparison) -> str:
    return p_text(c.p if c.p_holm is None else c.p_holm)


def _holm(tests: int) -> str:
    return f", Holm-corrected for {tests} comparisons" if tests > 1 else ""


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
    return study.scenes[0] if len(study.scenes) == 1 else f"the mean of {len(study.scenes)} scenes"


def _pairs(study: Study) -> str:
    return "seeds, paired" if len(study.scenes) == 1 else "pairs of scene and seed"
