"""What a method gains with other photos of the same scene."""

from __future__ import annotations

import numpy as np

from framework.report.parts.document import Block, Heading, Text, table
from framework.report.statistics.drawn import Draws, draws
from framework.report.statistics.numbers import ABSENT, interval_text, p_text, signed, significant
from framework.report.study.runs import Study

WORDS = ("Scene", "Method", "Compared with", "Each draw (dB)")
TEXT = (
    "The test photos are the same, the training photos were drawn by lot. Each draw: the mean over"
    " its seeds of method minus baseline. Mean: over the draws, with a t interval over them: what"
    " other photos of the same scene would give. Draws alike: analysis of variance of the seeds'"
    " differences; a small p says that the gain depends on the photos, and not on luck with seeds."
    " Every row is of itself: nothing is corrected for the number of rows."
)


def over_draws(study: Study) -> list[Block]:
    """A row for every scene and method; nothing where no photos were drawn."""
    found = draws(study)
    if not found:
        return []
    return [Heading(2, "With other photos"), Text(TEXT), table([_row(d) for d in found], WORDS)]


def _row(own: Draws) -> dict[str, str]:
    inside = own.over.interval()
    return {
        "Scene": own.scene,
        "Method": own.method,
        "Compared with": own.baseline,
        "Each draw (dB)": ", ".join(signed(gain) for gain in own.gains),
        "Mean (dB)": signed(own.over.mean),
        "other photos, 95 %": interval_text(inside) if inside else ABSENT,
        "σ of draws (dB)": significant(float(np.std(own.gains, ddof=1))),
        "σ of seeds (dB)": ABSENT if own.alike is None else significant(own.alike.sd),
        "Draws alike": ABSENT if own.alike is None or own.alike.p is None else p_text(own.alike.p),
    }
