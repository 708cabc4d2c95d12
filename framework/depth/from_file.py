"""`depth=file`: depth maps from a folder, see `read` and `align`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from framework.depth.options import DepthFileOptions

if TYPE_CHECKING:
    from framework.types import DepthMap, TrainingSet


@dataclass(frozen=True)
class DepthFile(DepthFileOptions):
    """One file per training view in `path`, named by the view without its suffix, subfolders
    included: `.npy`, `.npz` (key `depth`) or 16-bit `.png`. 0 = unknown; maps are resampled to the
    image's size."""

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
