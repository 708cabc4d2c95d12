"""`capacity=fixed`: keep the number of initial Gaussians."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from framework.plugin import Capacity, Edits, StepContext, StepStats, register


@register("capacity", "fixed")
@dataclass(frozen=True)
class Fixed(Capacity):
    """No edits."""

    idle: ClassVar[bool] = True

    def update(self, ctx: StepContext, state: Any, stats: StepStats) -> tuple[Edits | None, Any]:
        return None, state
