"""`augment=none`: train on real views only."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from framework.plugin import Augmenter, StepContext, register


@register("augment", "none")
@dataclass(frozen=True)
class NoAugmentation(Augmenter):
    """No pseudo views."""

    idle: ClassVar[bool] = True

    @classmethod
    def weighted(cls) -> bool:
        """There is nothing to weight."""
        return False

    def pseudo_views(self, ctx: StepContext, state: Any) -> tuple[list[Any], Any]:
        return [], state
