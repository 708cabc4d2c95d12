"""The tables of comparisons: differences of means over these scenes and over scenes like these, and
ratios of deviations over seeds."""

from __future__ import annotations

from framework.report.statistics.bootstrap import sd_interval
from framework.report.statistics.compare import Comparison
from framework.report.statistics.numbers import (
    ABSENT,
    interval_text,
    p_text,
    signed,
    significant,
    spanned,
)
from framework.report.statistics.outcomes import Outcomes
from framework.report.statistics.power import MOST_SEEDS
from framework.report.statistics.variance import SigmaComparison

Rows = list[dict[str, str]]


def comparison_rows(found: Outcomes) -> Rows:
    """Every method against its baseline."""
    return [
        {"Method": c.method, "Compared with": c.baseline, **tested_cells(c)}
        for c in found.comparisons.values()
    ]


def tested_cells(c: Comparison) -> dict[str, str]:
    """The figures of a paired comparison, all corrected for the comparisons beside it."""
    cells = {
        "Seeds": str(c.n),
        "ΔPSNR (dB)": signed(c.difference),
        "these scenes, 95 %": interval_text(c.joint) if c.joint else ABSENT,
        "p": p_text(c.p_joint) if c.p_joint is not None else ABSENT,
    }
    if c.like is not None:
        cells["Scenes"] = str(c.like.n)
        cells["scenes like these, 95 %"] = interval_text(c.like_joint) if c.like_joint else ABSENT
    return cells


def sigma_rows(found: Outcomes) -> Rows:
    """The standard deviation of every method against its baseline's."""
    return [
        {
            "Method": c.method,
            "Compared with": c.baseline,
            "σ / σ": significant(c.ratio) if c.ratio is not None else ABSENT,
            "95 % interval": spanned(c.interval) if c.interval else ABSENT,
            "r": ABSENT if c.rho is None else f"{c.rho:.2f}",
            "p": p_text(c.p_joint),
            "Seeds": str(c.n) if c.n == c.other_n else f"{c.n} and {c.other_n}",
            "Found 8 times in 10 below": ABSENT
            if c.detectable is None
            else significant(c.detectable),
            "Seeds needed": seeds_text(c),
        }
        for c in found.sigmas.values()
    ]


def deviation_rows(found: Outcomes) -> Rows:
    """σ_PSNR with both its intervals, and over several scenes both its readings."""
    rows = []
    for method, psnr in found.psnr.items():
        own = found.scene_sigma.get(method)
        free = sd_interval(list(found.seeds[method].values()))
        several = bool(found.scene_sigma)
        row = {
            "Method": method,
            f"{'σ of the mean over scenes' if several else 'σ_PSNR'} (dB)": ABSENT
            if psnr.sd is None
            else significant(psnr.sd),
            "95 %, normal errors": ABSENT if not psnr.sd_interval else spanned(psnr.sd_interval),
            "95 %, bootstrap": ABSENT if free is None else spanned(free),
            "Seeds": str(psnr.n),
        }
        if several:
            row["mean of the scenes' σ (dB)"] = (
                ABSENT if own is None else f"{significant(own[0])} [{spanned(own[1])}]"
            )
        rows.append(row)
    return rows


def seeds_text(c: SigmaComparison) -> str:
    """How many seeds per method would tell this ratio from 1."""
    if c.ratio is None:
        return ABSENT
    return f"more than {MOST_SEEDS}" if c.seeds is None else str(c.seeds)
