"""The embedded scene: procedural, ray-traced, exact. It needs no download and has no unknowns.

A room corner from 2 m to 8 m: photographs bundled with scikit-image, boxes, a mirror ball, a glazed
vase, a plant, a thin lattice, wires, a plain cupboard. It is generated once per set of options and
cached, with the same bits on every machine. Poses, intrinsics and depth are exact.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from framework.scenes.embedded.options import EmbeddedOptions

if TYPE_CHECKING:
    from framework.types import Scene


@dataclass(frozen=True)
class Embedded(EmbeddedOptions):
    """A ray-traced room in the repository itself, with exact depth.

    The training cameras form a zigzag (protocol `rig`). The eight test cameras are always the same.
    """

    poses_are_exact: ClassVar[bool] = True

    def load(self) -> Scene:
        """Load the scene from the cache, or generate it (a few seconds)."""
        from framework.scenes.embedded.generate import load

        return load(self)
