"""The common part of regularizers that drop Gaussians from a training render.

Such a method is a subclass that decides which Gaussians are dropped. How many, p(t) N in
expectation, how that grows over the training, and when the method acts are here, so that methods
compare at the same rate. Light to import.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from framework.plugin import Regularizer

SCHEDULES = ("linear", "constant")


@dataclass(frozen=True)
class DropoutRegularizer(Regularizer):
    """p: the paper's drop rate, the expected share of Gaussians dropped in a step. schedule:
    "linear" gives p(t) = p x progress of the whole training (as DropGaussian's), "constant" keeps
    p. compensate: scale up what is kept, so that every opacity keeps its expectation. The warm-up
    is the framework key `start`.
    """

    p: float = 0.1
    schedule: str = "linear"
    compensate: bool = False

    # chosen on the embedded scene and on held-out training views of two real ones: a last fifth
    # without dropout lets the opacities settle
    defaults: ClassVar[dict[str, float]] = {"start": 0.1, "stop": 0.8}

    def __post_init__(self) -> None:
        self.check("p", 0 < self.p < 1, "a number in (0, 1)")
        self.check("schedule", self.schedule in SCHEDULES, f"one of {', '.join(SCHEDULES)}")

    def drop_rate(self, progress: float) -> float:
        """p(t), the expected share of Gaussians dropped at `progress` in [0, 1)."""
        return self.p * progress if self.schedule == "linear" else self.p
