"""Depth providers: where the depth of the training views comes from.

Every provider is a frozen dataclass whose fields are its options, derived from
`framework.depth.provider.DepthProvider`: it implements `measure(training)`, which gives one
`framework.types.DepthMap` per training view, in their order, and `fingerprint(training)`, which
tells the files that were read. Importing this package loads neither torch nor numba.
`exposure` tells from photos and depth how the photos were exposed.
"""

from __future__ import annotations

from framework.depth.depth_anything_3 import DepthAnything3
from framework.depth.from_file import DepthFile
from framework.depth.ground_truth import GroundTruth
from framework.depth.learned import FusedDepth, IterMvsDepth
from framework.depth.plane_sweep import PlaneSweep
from framework.depth.provider import DepthProvider, unspoiled

__all__ = [
    "PROVIDERS",
    "DepthProvider",
    "consistency",
    "exposure",
    "itermvs",
    "matching",
    "options",
    "pose_check",
    "transfer",
    "unspoiled",
]

PROVIDERS: dict[str, type] = {
    "ground_truth": GroundTruth,
    "plane_sweep": PlaneSweep,
    "file": DepthFile,
    "itermvs": IterMvsDepth,
    "fused": FusedDepth,
    "depth_anything_3": DepthAnything3,
}
