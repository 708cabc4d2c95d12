"""Depth providers: where the depth of the training views comes from.

Every provider is a frozen dataclass whose fields are its options, with the methods
`estimate(training) -> tuple[DepthMap, ...]`, one map per training view, in their order (see
`framework.types.DepthMap`), and `fingerprint(training) -> str` of the files it reads. Importing
this package loads neither torch nor numba.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Protocol

from framework.depth.from_file import DepthFile
from framework.depth.ground_truth import GroundTruth
from framework.depth.plane_sweep import PlaneSweep
from framework.errors import UserError, nearest_hint

if TYPE_CHECKING:
    from framework.types import DepthMap, TrainingSet

__all__ = ["PROVIDERS", "DepthProvider", "build_provider"]


class DepthProvider(Protocol):
    """What all providers offer."""

    def estimate(self, training: TrainingSet) -> tuple[DepthMap, ...]:
        """One depth map per training view, in their order."""
        ...

    def fingerprint(self, training: TrainingSet) -> str:
        """What beside the options and the training set determines the maps: SHA-256 hex of the
        files that `estimate` reads, "" if it reads none."""
        ...


PROVIDERS: dict[str, type] = {
    "ground_truth": GroundTruth,
    "plane_sweep": PlaneSweep,
    "file": DepthFile,
}


def build_provider(name: str, options: Mapping[str, Any]) -> DepthProvider:
    """The provider `depth=name` with `options`. Raises UserError on an unknown name or option."""
    if name not in PROVIDERS:
        raise UserError(f"depth={name}: unknown depth provider; {nearest_hint(name, PROVIDERS)}")
    cls = PROVIDERS[name]
    known = [field.name for field in dataclasses.fields(cls)]
    for key in options:
        if key not in known:
            raise UserError(f"depth={name}: unknown option '{key}'; {nearest_hint(key, known)}")
    provider: DepthProvider = cls(**options)
    return provider
