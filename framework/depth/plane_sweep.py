"""`depth=plane_sweep`: stereo from the training photos alone; options only, see `sweep`."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import TYPE_CHECKING

from framework.depth.provider import DepthProvider
from framework.errors import check_option

if TYPE_CHECKING:
    from framework.types import DepthMap, TrainingSet


@dataclass(frozen=True)
class PlaneSweep(DepthProvider):
    """Plane sweep (Collins 1996) with ZNCC, semi-global aggregation (Hirschmueller 2008) and a
    cross-view consistency check. Penalties are in units of 1 - ZNCC."""

    planes: int = 96  # of inverse depth, evenly spaced
    radius: int = 3  # of the (2 r + 1)^2 window, pixels
    neighbours: int = 4  # views each view is matched with, at most
    penalty_small: float = 0.1  # P1: the match moves by one pixel from pixel to pixel
    penalty_large: float = 1.0  # P2: it moves by more; less so across image edges
    edge: float = 20.0  # P2 is divided by 1 + edge x grey difference
    tolerance: float = 0.03  # relative depth difference at which two views still agree

    def __post_init__(self) -> None:
        super().__post_init__()
        check = functools.partial(check_option, self, "depth")
        check("planes", 3 <= self.planes <= 2048, "3 to 2048")
        check("radius", 1 <= self.radius <= 15, "1 to 15 pixels")
        check("neighbours", self.neighbours >= 1, "an integer >= 1")
        check("penalty_small", 0 <= self.penalty_small <= 1, "a number in [0, 1]")
        check(
            "penalty_large",
            self.penalty_small <= self.penalty_large <= 1,
            f"a number from penalty_small = {self.penalty_small} to 1",
        )
        check("edge", self.edge >= 0, "a number >= 0")
        check("tolerance", 0 < self.tolerance < 1, "a share in (0, 1)")

    def measure(self, training: TrainingSet) -> tuple[DepthMap, ...]:
        """Dense depth of every training view; confidence > 0 only where another view agrees.

        Raises UserError if there are fewer than two views, or no two of them overlap.
        """
        from framework.depth.sweep import sweep_views

        return sweep_views(training, self)
