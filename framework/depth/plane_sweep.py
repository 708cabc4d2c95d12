"""`depth=plane_sweep`: stereo from the training photos alone, see `matching.sweep`."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import TYPE_CHECKING

from framework.depth.options import PlaneSweepOptions

if TYPE_CHECKING:
    from framework.types import DepthMap, TrainingSet

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class PlaneSweep(PlaneSweepOptions):
    """Plane sweep (Collins 1996) with ZNCC, semi-global aggregation (Hirschmueller 2008) and a
    cross-view consistency check. Penalties are in units of 1 - ZNCC."""

    def measure(self, training: TrainingSet) -> tuple[DepthMap, ...]:
        """Dense depth of every training view; confidence > 0 only where another view agrees.

        Raises UserError if there are fewer than two views, or no two of them overlap.
        """
        from framework.depth.matching.sweep import sweep_views

        maps = sweep_views(training, self)
        for view, depth in zip(training.views, maps, strict=True):
            if not depth.depth.any():
                log.warning("plane sweep: view '%s' overlaps no other, it gets no depth", view.name)
        return maps
