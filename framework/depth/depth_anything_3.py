"""`depth=depth_anything_3`: the network Depth Anything 3, given the poses."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import TYPE_CHECKING

from framework.depth.provider import DepthProvider
from framework.errors import check_option

if TYPE_CHECKING:
    from framework.types import DepthMap, TrainingSet

ALIGNMENTS = ("points", "plane_sweep", "none")
PATCH = 14  # pixels per token; the network's input sizes are its multiples


@dataclass(frozen=True)
class DepthAnything3(DepthProvider):
    """Depth of all training views at once, conditioned on their poses (Lin et al. 2025).

    The package `depth_anything_3` and weights that take poses are needed; the default ones are
    those of the Apache 2.0 licence.
    """

    weights: str = "depth-anything/DA3-BASE"  # on the Hugging Face hub, or a local folder
    revision: str = "main"  # branch, tag or commit on the hub
    align: str = "points"  # each view's scale: sparse points, plane_sweep, or none (the poses')
    process_res: int = 504  # longer side of the network's input, pixels
    device: str = "cpu"  # of torch
    tolerance: float = 0.05  # relative, of a cross-view check as in plane_sweep; 0 = trust all

    def __post_init__(self) -> None:
        super().__post_init__()
        check = functools.partial(check_option, self, "depth")
        check("weights", self.weights != "", "a name on the hub or a folder")
        check("revision", self.revision != "", "a branch, tag or commit of the hub")
        check("align", self.align in ALIGNMENTS, f"one of {', '.join(ALIGNMENTS)}")
        check("process_res", self.process_res >= PATCH, f"at least {PATCH} pixels")
        check("device", self.device != "", "a torch device (cpu, cuda)")
        check("tolerance", 0 <= self.tolerance < 1, "a share in [0, 1)")

    def measure(self, training: TrainingSet) -> tuple[DepthMap, ...]:
        """Depth in scene units; confidence from the network's own, 0 in its sky and where no other
        view agrees.

        Raises UserError if package, weights or sparse points are missing, the images differ in
        size, or the network fails.
        """
        from framework.depth.network import predict_views

        return predict_views(training, self)

    def fingerprint(self, training: TrainingSet) -> str:
        """SHA-256 hex of the weights and the package's version. Raises UserError without them."""
        from framework.depth.network import weights_sha256

        return weights_sha256(self)
