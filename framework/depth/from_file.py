"""`depth=file`: depth maps from a folder; options only, see `read` and `align`."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import TYPE_CHECKING

from framework.depth.provider import DepthProvider
from framework.errors import check_option

if TYPE_CHECKING:
    from framework.types import DepthMap, TrainingSet

KINDS = ("depth", "inverse_depth")
ALIGNMENTS = ("scale", "scale_shift", "none")
INVALID = ("error", "mask")


@dataclass(frozen=True)
class DepthFile(DepthProvider):
    """One file per training view in `path`, named by the view without its suffix, subfolders
    included: `.npy`, `.npz` (key `depth`) or 16-bit `.png`. 0 = unknown; maps are resampled to the
    image's size."""

    path: str = ""  # folder of the depth maps
    kind: str = "depth"  # what the maps hold: depth or inverse_depth
    align: str = "scale"  # to the sparse points: scale, scale_shift or none (already scene units)
    invalid: str = "error"  # NaN, infinity and negative values: error, or mask (unknown)
    png_scale: float = 1000.0  # png values are divided by it
    tolerance: float = 0.0  # relative, of a cross-view check as in plane_sweep; 0 = trust all

    def __post_init__(self) -> None:
        super().__post_init__()
        check = functools.partial(check_option, self, "depth")
        check("path", self.path != "", "the folder of the depth maps")
        check("kind", self.kind in KINDS, f"one of {', '.join(KINDS)}")
        check("align", self.align in ALIGNMENTS, f"one of {', '.join(ALIGNMENTS)}")
        check("invalid", self.invalid in INVALID, f"one of {', '.join(INVALID)}")
        check("png_scale", self.png_scale > 0, "a number > 0")
        check("tolerance", 0 <= self.tolerance < 1, "a share in [0, 1)")

    def measure(self, training: TrainingSet) -> tuple[DepthMap, ...]:
        """The aligned maps; confidence 1 where depth is known (and, with `tolerance`, confirmed).

        Raises UserError on a missing, unreadable or invalid file, or too few points to align with.
        """
        from framework.depth.read import read_views

        return read_views(training, self)

    def fingerprint(self, training: TrainingSet) -> str:
        """SHA-256 hex of the files of all training views. Raises UserError on a missing one."""
        from framework.depth.read import files_sha256

        return files_sha256(training, self)
