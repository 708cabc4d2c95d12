"""`depth=itermvs` and `depth=fused`: a learned multi-view stereo network, alone or with the plane
sweep. Importing this module loads neither torch nor numba."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from framework.depth.options import IterMvsOptions

if TYPE_CHECKING:
    from framework.types import DepthMap, TrainingSet


@dataclass(frozen=True)
class _Learned(IterMvsOptions):
    """A provider that needs the weights of IterMVS."""

    def ready(self) -> None:
        """Raise UserError if the weights have not been fetched."""
        from framework.depth.itermvs.weights import require_weights

        require_weights(self.weights)

    def learned_weights(self) -> str:
        """Return the network and its training data."""
        return f"IterMVS, {self.weights}"

    def fingerprint(self, training: TrainingSet) -> str:
        """Return the SHA-256 of the published checkpoint."""
        from framework.depth.itermvs.weights import SHA256

        return SHA256[self.weights]


@dataclass(frozen=True)
class IterMvsDepth(_Learned):
    """Depth by IterMVS (Wang et al. 2022) where it is confident and another view agrees."""

    def measure(self, training: TrainingSet) -> tuple[DepthMap, ...]:
        """Return depth in scene units; confidence is the network's, 0 where it is not used.

        Raises:
            UserError: Fewer than two views, or no weights.
        """
        from framework.depth.itermvs.views import measure_views

        return measure_views(training, self)


@dataclass(frozen=True)
class FusedDepth(_Learned):
    """Depth by IterMVS where it is confident and another view agrees closely, else by the plane
    sweep where another view agrees, else by IterMVS."""

    def measure(self, training: TrainingSet) -> tuple[DepthMap, ...]:
        """Return depth in scene units; confidence is that of the source of each pixel.

        Raises:
            UserError: Fewer than two views, no overlap, or no weights.
        """
        from framework.depth.itermvs.views import fused_views

        return fused_views(training, self)
