"""`depth=depth_anything_3`: the network Depth Anything 3, given the poses."""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass
from typing import TYPE_CHECKING

from framework.depth.options import DEPTH_ANYTHING_3, DepthAnything3Options
from framework.errors import require

if TYPE_CHECKING:
    from framework.types import DepthMap, TrainingSet


@dataclass(frozen=True)
class DepthAnything3(DepthAnything3Options):
    """Depth of all training views at once, conditioned on their poses (Lin et al. 2025).

    The package `depth_anything_3` and weights that take poses are needed; the default ones are
    those of the Apache 2.0 licence.
    """

    def measure(self, training: TrainingSet) -> tuple[DepthMap, ...]:
        """Depth in scene units; confidence from the network's own, 0 in its sky and where no other
        view agrees.

        Raises UserError if package, weights or sparse points are missing, the images differ in
        size, or the network fails.
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
        """SHA-256 hex of the weights and the package's version. Raises UserError without them."""
        from framework.depth.network import weights_sha256

        return weights_sha256(self)
