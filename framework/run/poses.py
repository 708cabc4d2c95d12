"""The stage of a run that checks its poses, and the repairs it tries where they do not fit."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

from framework.depth.pose_check import PoseCheck, check_poses
from framework.scenes.conventions import CONVENTIONS, repaired
from framework.types import TrainingSet, View

Remedy = tuple[str, Callable[[TrainingSet], TrainingSet]]

RANGE = 4.0  # farthest over nearest depth of the ranges beside the scene's

log = logging.getLogger(__name__)


def checked_poses(name: str, loader: object, training: TrainingSet) -> PoseCheck | None:
    """Check the poses by stereo and warn if they do not fit; None if they cannot be checked.

    Args:
        name: of the scene's loader.
        loader: not checked if it has `poses_are_exact`. The warning may suggest another convention
            if it has an option `poses`.
        training: the loaded training set.
    """
    if getattr(loader, "poses_are_exact", False):
        return None
    check = check_poses(training, list(_remedies(getattr(loader, "poses", None))))
    if check is not None and not check.fits:
        log.warning("scene=%s: %s", name, check.warning())
    return check


def _remedies(convention: str | None) -> Iterator[Remedy]:
    """(What would fit and how to get it, the repair). convention: as the loader read them."""
    for other in CONVENTIONS if convention else ():
        if other != convention:
            text = f"they fit when read as {other}: scene.poses={other}"
            yield text, partial(repaired, layout=convention or "", other=other)
    upside_down = "they fit photos turned by 180 degrees: apply the EXIF orientation to the files"
    yield upside_down, _turned
    moved = "they fit if the scene lies {} than said: correct scene.near and scene.far"
    yield moved.format("farther away"), lambda t: _between(t, t.far, RANGE * t.far)
    yield moved.format("nearer"), lambda t: _between(t, t.near / RANGE, t.near)


def _turned(training: TrainingSet) -> TrainingSet:
    """Every photo and mask turned by half a turn."""

    def turned(view: View) -> View:
        mask = None if view.mask is None else view.mask.flip(0, 1).contiguous()
        return replace(view, image=view.image.flip(1, 2).contiguous(), mask=mask)

    return replace(training, views=tuple(map(turned, training.views)))


def _between(training: TrainingSet, near: float, far: float) -> TrainingSet:
    """The training set with other depth bounds and without points, which would overrule them."""
    points = training.points
    none = replace(points, xyz=points.xyz[:0], rgb=points.rgb[:0], visible=points.visible[:0])
    return replace(training, points=none, near=near, far=far)
