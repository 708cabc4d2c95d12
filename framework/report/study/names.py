"""What the metrics are called in tables: LPIPS by its network, and by what it is fed."""

from __future__ import annotations

from framework.metrics.values import AVERAGE, COADAPTATION, METRICS, RANK
from framework.records import record
from framework.report.study.labels import outside
from framework.report.study.runs import Study

LPIPS = ("lpips", "lpips_01")
NAMES = {
    **{"psnr": "PSNR", "ssim": "SSIM", "flip": "FLIP", "lpips": "LPIPS"},
    "lpips_01": "LPIPS fed [0, 1], as papers do",
    **{AVERAGE: "AVGE", COADAPTATION: "Co-adaptation"},
    RANK: "Effective rank",
}
UNITS = {"psnr": "(dB)", "ssim": "↑", RANK: "(1 needles, 3 balls)"}


def heading_of(metric: str, study: Study | None = None) -> str:
    """The heading of a metric's column; of LPIPS with the network that the runs were measured with,
    if they tell it."""
    if metric not in NAMES:  # a plugin's, which says itself what is better
        return outside(metric)
    unit = UNITS.get(metric, "↓")
    told = networks(study) if study is not None and metric in LPIPS else []
    if not told:
        return f"{NAMES[metric]} {unit}"
    name, rest = NAMES[metric][: len("LPIPS")], NAMES[metric][len("LPIPS") :]
    return f"{name} ({', '.join(told)}){rest} {unit}"


def own_metrics(study: Study) -> list[str]:
    """What plugins measured beside `METRICS` in some run, sorted."""
    return sorted({name for run in study.runs for name in run.record.summary} - {*METRICS})


def networks(study: Study) -> list[str]:
    """The networks that LPIPS was measured with, sorted; runs of before do not tell theirs."""
    told = [
        r.record.provenance.get(record.LPIPS) for r in study.runs if r.mean("lpips") is not None
    ]
    return sorted({outside(str(name)) for name in told if name})
