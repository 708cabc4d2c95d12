"""`depth=itermvs` and `depth=fused`: a learned multi-view stereo network, alone or with the plane
sweep. Importing this module loads neither torch nor numba."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from framework.depth.provider import DepthProvider

if TYPE_CHECKING:
    from framework.types import DepthMap, TrainingSet

WEIGHTS = ("blendedmvs", "dtu")


@dataclass(frozen=True)
class IterMvsOptions(DepthProvider):
    """Options of `depth=itermvs` and `depth=fused`."""

    weights: str = "blendedmvs"  # blendedmvs, or dtu (whose training scenes include scan 65)
    neighbours: int = 4  # views each view is matched with, at most
    least_confidence: float = 0.1  # of the network; depth below is not used
    tolerance: float = 0.03  # relative depth difference at which two views still agree

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check("weights", self.weights in WEIGHTS, f"one of {', '.join(WEIGHTS)}")
        self.check("neighbours", self.neighbours >= 1, "an integer >= 1")
        self.check("least_confidence", 0 <= self.least_confidence <= 1, "a number in [0, 1]")
        self.check("tolerance", 0 < self.tolerance < 1, "a share in (0, 1)")

    def ready(self) -> None:
        """Raise UserError if the weights have not been fetched."""
        from framework.depth.itermvs.weights import require_weights

        require_weights(self.weights)

    def fingerprint(self, training: TrainingSet) -> str:
        """Return the SHA-256 of the published checkpoint."""
        from framework.depth.itermvs.weights import SHA256

        return SHA256[self.weights]


@dataclass(frozen=True)
class IterMvsDepth(IterMvsOptions):
    """Depth by IterMVS (Wang et al. 2022) where it is confident and another view agrees."""

    def measure(self, training: TrainingSet) -> tuple[DepthMap, ...]:
        """Return depth in scene units; confidence is the network's, 0 where it is not used.

        Raises:
            UserError: Fewer than two views, or no weights.
        """
        from framework.depth.itermvs.views import measure_views

        return measure_views(training, self)


@dataclass(frozen=True)
class FusedDepth(IterMvsOptions):
    """Depth by IterMVS where it is confident and another view agrees closely, else by the plane
    sweep where another view agrees, else by IterMVS."""

    def measure(self, training: TrainingSet) -> tuple[DepthMap, ...]:
        """Return depth in scene units; confidence is that of the source of each pixel.

        Raises:
            UserError: Fewer than two views, no overlap, or no weights.
        """
        from framework.depth.itermvs.views import fused_views

        return fused_views(training, self)
