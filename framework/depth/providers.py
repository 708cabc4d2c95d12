"""The depth providers, `depth=NAME`.

Each is a frozen dataclass of options, whose `measure` imports the code that it needs.
"""

from __future__ import annotations

import importlib.util
import logging
from dataclasses import dataclass
from typing import TYPE_CHECKING

from framework.depth.options import (
    DEPTH_ANYTHING_3,
    DepthAnything3Options,
    DepthFileOptions,
    DepthProvider,
    IterMvsOptions,
    PlaneSweepOptions,
)
from framework.errors import UserError, require

if TYPE_CHECKING:
    from framework.types import DepthMap, TrainingSet

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class GroundTruth(DepthProvider):
    """The exact depth of a scene that has it, with confidence 1 where it is known."""

    def measure(self, training: TrainingSet) -> tuple[DepthMap, ...]:
        """Raises UserError if a view has no depth."""
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


@dataclass(frozen=True)
class PlaneSweep(PlaneSweepOptions):
    """Plane sweep (Collins 1996) with ZNCC, semi-global aggregation (Hirschmueller 2008) and a
    cross-view consistency check. Penalties are in units of 1 - ZNCC."""

    def measure(self, training: TrainingSet) -> tuple[DepthMap, ...]:
        """Dense depth of every training view; confidence > 0 only where another view agrees.

        Raises:
            UserError: if there are fewer than two views, or no two of them overlap.
        """
        from framework.depth.matching.sweep import sweep_views

        maps = sweep_views(training, self)
        for view, depth in zip(training.views, maps, strict=True):
            if not depth.depth.any():
                log.warning("plane sweep: view '%s' overlaps no other, it gets no depth", view.name)
        return maps


@dataclass(frozen=True)
class DepthFile(DepthFileOptions):
    """One file per training view in `path`: `.npy`, `.npz` (key `depth`) or 16-bit `.png`.

    Files are named by the view without its suffix, including sub-folders. 0 = unknown; maps are
    resampled to the image's size.
    """

    def measure(self, training: TrainingSet) -> tuple[DepthMap, ...]:
        """The aligned maps; confidence 1 where depth is known (and, with `tolerance`, confirmed).

        Raises:
            UserError: on a missing, unreadable or invalid file, or too few points to align with.
        """
        from framework.depth.read import read_views

        return read_views(training, self)

    def fingerprint(self, training: TrainingSet) -> str:
        """SHA-256 hex of the files of all training views.

        Raises:
            UserError: on a missing one.
        """
        from framework.depth.read import files_sha256

        return files_sha256(training, self)


@dataclass(frozen=True)
class DepthAnything3(DepthAnything3Options):
    """Depth of all training views at once, conditioned on their poses (Lin et al. 2025).

    The package `depth_anything_3` and weights that take poses are needed; the default ones are
    those of the Apache 2.0 licence.
    """

    def measure(self, training: TrainingSet) -> tuple[DepthMap, ...]:
        """Depth in scene units, with the network's confidence; 0 in its sky and where no other
        view agrees.

        Raises:
            UserError: if package, weights or sparse points are missing, the images differ in size,
                or the network fails.
        """
        from framework.depth.network import predict_views

        return predict_views(training, self)

    def ready(self) -> None:
        require(
            importlib.util.find_spec("depth_anything_3") is not None,
            f"depth=depth_anything_3: expected the package depth_anything_3, got none; install"
            f" it with: pip install {DEPTH_ANYTHING_3}",
        )

    def learned_weights(self) -> str:
        """Return the name of the weights."""
        return self.weights

    def fingerprint(self, training: TrainingSet) -> str:
        """SHA-256 hex of the weights and the package's version.

        Raises:
            UserError: without them.
        """
        from framework.depth.network import weights_sha256

        return weights_sha256(self)


@dataclass(frozen=True)
class _Learned(IterMvsOptions):
    """A provider that needs the weights of IterMVS."""

    def ready(self) -> None:
        """Raise UserError if the weights have not been fetched."""
        from framework.depth.itermvs.weights import require_weights

        require_weights(self.weights)

    def learned_weights(self) -> str:
        """Return the network, its training data and the checkpoint's hash."""
        from framework.depth.itermvs.weights import SHA256

        return f"IterMVS, {self.weights} (sha256 {SHA256[self.weights][:12]})"

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


PROVIDERS: dict[str, type] = {
    "ground_truth": GroundTruth,
    "plane_sweep": PlaneSweep,
    "file": DepthFile,
    "itermvs": IterMvsDepth,
    "fused": FusedDepth,
    "depth_anything_3": DepthAnything3,
}
