"""The placing of photos whose matches are known, by pycolmap's incremental mapping: with which
thresholds, and whose focal length, EXIF's or the photos' own.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from framework.scenes.photos.found import Overruled
from framework.scenes.photos.prepare import Photo
from framework.scenes.photos.steps import Step, agree, decisive, mapping, plausible
from framework.scenes.photos.telling import Telling


@dataclass(frozen=True)
class Placing:
    """models: pycolmap's, the one of most photos first. held: their focal length was given, not
    found. overruled: the one of EXIF that was not taken."""

    models: list[Any]
    held: bool = False
    overruled: Overruled | None = None

    @property
    def size(self) -> int:
        """Photos placed in the first model."""
        return size(self.models[0]) if self.models else 0


def size(model: Any) -> int:
    """Photos placed in it."""
    return int(model.num_reg_images())


def place(
    step: Step, photos: Sequence[Photo], images: Path, work: Path, telling: Telling
) -> Placing:
    """With the usual thresholds, or with lower ones if these place more."""
    best = Placing([])
    for low in (False, True):

        def mapped(held: bool, low: bool = low) -> list[Any]:
            return _mapped(mapping(step, low, held), photos, images, work, telling)

        found = choose(mapped, photos)
        if found.size > best.size:
            best = found
        if best.size == len(photos):
            break
    return best


def choose(mapped: Callable[[bool], list[Any]], photos: Sequence[Photo]) -> Placing:
    """The models with the focal length that the photos tell, or with the given one.

    mapped: held -> the models. Found ones are taken where they are plausible, and EXIF tells about
    the same or fits clearly worse; else the given ones, as far as these place something.
    """
    free = Placing(mapped(False))
    if not free.models:
        return free
    told, is_plausible = _farthest(free.models[0], photos), _is_plausible(free.models[0])
    if is_plausible and (told is None or agree(*told)):
        return free
    held = Placing(mapped(True), held=True)
    if told is None or not is_plausible:
        return held
    error, error_held = _error(free), None if held.size < free.size else _error(held)
    if error_held is None or decisive(error_held, error):
        return replace(free, overruled=Overruled(*told, error_held, error))
    return held


def _is_plausible(model: Any) -> bool:
    """Whether all its cameras are."""
    cameras = [model.image(i).camera for i in model.reg_image_ids()]
    return all(
        plausible(float(c.params[0]), float(c.params[3]), max(c.width, c.height)) for c in cameras
    )


def _farthest(model: Any, photos: Sequence[Photo]) -> tuple[float, float] | None:
    """(EXIF's, found) focal length in pixels, of the photo in which they differ most; None where
    EXIF tells none."""
    exif = {photo.stored: photo.focal_px for photo in photos}
    pairs = []
    for i in model.reg_image_ids():
        image = model.image(i)
        told = exif[image.name]
        if told is not None:
            pairs.append((float(told), float(image.camera.params[0])))
    return max(pairs, key=lambda pair: max(pair) / min(pair), default=None)


def _error(placing: Placing) -> float:
    """Mean distance in pixels between a feature and where its point is projected."""
    return float(placing.models[0].compute_mean_reprojection_error())


def _mapped(
    options: Any, photos: Sequence[Photo], images: Path, work: Path, tell: Telling
) -> list[Any]:
    import pycolmap

    tick, placed = tell.ticks("photos placed"), [0]

    def count(more: int) -> None:
        placed[0] = min(placed[0] + more, len(photos))
        tick(placed[0], len(photos))

    def begin() -> None:
        placed[0] = 0  # a model may be given up, and another one begun
        count(2)

    models = pycolmap.incremental_mapping(
        work / "database.db",
        images,
        work,
        options,
        initial_image_pair_callback=begin,
        next_image_callback=lambda: count(1),
    )
    return sorted(models.values(), key=lambda model: (-size(model), -model.num_points3D()))
