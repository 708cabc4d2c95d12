"""`depth=ground_truth`: the exact depth a scene carries, where it does."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from framework.depth.provider import DepthProvider
from framework.errors import UserError

if TYPE_CHECKING:
    from framework.types import DepthMap, TrainingSet


@dataclass(frozen=True)
class GroundTruth(DepthProvider):
    """`View.depth`, with confidence 1 wherever it is known."""

    def measure(self, training: TrainingSet) -> tuple[DepthMap, ...]:
        """One map per training view. Raises UserError if a view has no depth."""
        from framework.types import DepthMap

        maps = []
        for view in training.views:
            if view.depth is None:
                raise UserError(
                    f"depth=ground_truth: expected exact depth in scene '{training.scene}', got"
                    f" none for view '{view.name}'; use depth=plane_sweep or depth=file"
                )
            maps.append(DepthMap(view.depth, (view.depth > 0).to(view.depth.dtype)))
        return tuple(maps)
