"""A run, opened for rendering: its Gaussians, its background and cameras."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from framework.errors import require
from framework.files.opened import is_file
from framework.records.cameras import NEAR, TRANSFORMS
from framework.records.record import PLY

if TYPE_CHECKING:
    from torch import Tensor

    from framework.exports.given import Given
    from framework.types import Camera, Gaussians, Render


@dataclass(frozen=True)
class OpenedRun:
    """background: [3]. cameras: those of the training views. near: scene units, before which
    nothing is drawn."""

    folder: Path
    gaussians: Gaussians
    background: Tensor
    cameras: tuple[Given, ...]
    near: float

    def render(self, camera: Camera, depth: bool = False) -> Render:
        """What the camera sees."""
        from framework.kernels import rasterize

        return rasterize(
            self.gaussians, camera, background=self.background, near=self.near, depth=depth
        )


def open_run(folder: Path) -> OpenedRun:
    """Raises UserError unless it is the folder of a finished run."""
    import torch

    from framework.exports.given import read_given
    from framework.files.documents import read_json
    from framework.files.limits import TEXT_BYTES
    from framework.records.ply import read_ply

    require(
        is_file(folder / PLY) and is_file(folder / TRANSFORMS),
        f"{folder}: expected the folder of a finished run, with {PLY} and {TRANSFORMS}, found none;"
        " a study's runs lie in reports/STUDY/runs/NAME",
    )
    cameras = read_given(folder / TRANSFORMS)
    told = read_json(folder / TRANSFORMS, TEXT_BYTES)
    fits = isinstance(told, dict)
    require(fits, f"{folder / TRANSFORMS}: expected a run's cameras, got a list; train again")
    near = told.get("near_plane", NEAR)
    right = isinstance(near, int | float) and not isinstance(near, bool) and 0 < near < 1e9
    require(right, f"{folder / TRANSFORMS}: expected a positive near_plane, got {near!r:.80}")
    names = told.get("train_filenames")
    chosen = set(_texts(names)) & {given.name for given in cameras}
    training = tuple(given for given in cameras if given.name in chosen) or tuple(cameras)
    gaussians, background = read_ply(folder / PLY)
    require(len(gaussians) > 0, f"{folder / PLY}: expected Gaussians, got none; train again")
    if background is None:
        background = torch.zeros(3)
    return OpenedRun(folder, gaussians, background, training, float(near))


def _texts(value: object) -> Sequence[str]:
    return [text for text in value if isinstance(text, str)] if isinstance(value, list) else []
