"""Places photos with known matches by pycolmap's incremental mapping, and chooses a focal length.

Few photos from one side often do not determine the focal length, and the estimate diverges. EXIF
may be wrong too, as of cropped photos. If the estimate is implausible or far from EXIF's value, the
photos are placed again with a fixed focal length and no distortion. It is EXIF's, else 1.2 times
the longer side (42 mm on film). A plausible estimate that fits clearly better wins over EXIF's.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from framework.scenes.photos.options import Step, mapping
from framework.scenes.photos.prepare import Photo
from framework.scenes.photos.process import Messages
from framework.scenes.photos.result import Overruled

FOCAL = (0.4, 3.0)  # plausible focal lengths over the longer side: 14 to 108 mm on film
FOCAL_EXIF = 1.1  # ratio up to which an estimate agrees with EXIF's
WORSE = 1.25  # reprojection error; 1.0 where EXIF is right, 1.4 to 4.6 where it is wrong
DISTORTION = 0.5  # largest plausible coefficient k1


@dataclass(frozen=True)
class Placing:
    """pycolmap's models, the one of most photos first.

    Attributes:
        held: their focal length was fixed.
        overruled: EXIF's focal length, if it was not used.
    """

    models: list[Any] = field(default_factory=list)
    held: bool = False
    overruled: Overruled | None = None

    @property
    def size(self) -> int:
        """Photos placed in the first model."""
        return int(self.models[0].num_reg_images()) if self.models else 0


def place(
    step: Step, photos: Sequence[Photo], images: Path, work: Path, messages: Messages
) -> Placing:
    """Place photos with the usual thresholds, or with lower ones if these place more."""
    best = Placing()
    for low in (False, True):

        def models(held: bool, low: bool = low) -> list[Any]:
            return _models(mapping(step, low, held), photos, images, work, messages)

        placing = choose(models, photos)
        if placing.size > best.size:
            best = placing
        if best.size == len(photos):
            break
    return best


def choose(models: Callable[[bool], list[Any]], photos: Sequence[Photo]) -> Placing:
    """Choose between estimated and fixed focal lengths; see the module's docstring.

    Args:
        models: runs the mapping, with fixed focal lengths if its argument is True.
    """
    free = Placing(models(False))
    if not free.models:
        return free
    focals, is_plausible = _farthest_focals(free.models[0], photos), _is_plausible(free.models[0])
    if is_plausible and (focals is None or max(focals) <= FOCAL_EXIF * min(focals)):
        return free
    held = Placing(models(True), held=True)
    if focals is None or not is_plausible:
        return held
    error, error_held = _error(free), None if held.size < free.size else _error(held)
    if error_held is None or error_held > WORSE * error:
        return replace(free, overruled=Overruled(*focals, error_held, error))
    return held


def _is_plausible(model: Any) -> bool:
    """Whether all cameras of a model have plausible focal lengths and distortions."""
    cameras = [model.image(i).camera for i in model.reg_image_ids()]
    low, high = FOCAL
    return all(
        low <= float(c.params[0]) / max(c.width, c.height) <= high
        and abs(float(c.params[3])) <= DISTORTION
        for c in cameras
    )


def _farthest_focals(model: Any, photos: Sequence[Photo]) -> tuple[float, float] | None:
    """(EXIF's, estimated) focal length in pixels of the photo in which they differ most; None
    without EXIF."""
    exif = {photo.stored: photo.focal_px for photo in photos}
    pairs = []
    for i in model.reg_image_ids():
        image = model.image(i)
        focal = exif[image.name]
        if focal is not None:
            pairs.append((float(focal), float(image.camera.params[0])))
    return max(pairs, key=lambda pair: max(pair) / min(pair), default=None)


def _error(placing: Placing) -> float:
    """Mean reprojection error in pixels."""
    return float(placing.models[0].compute_mean_reprojection_error())


def _models(
    options: Any, photos: Sequence[Photo], images: Path, work: Path, messages: Messages
) -> list[Any]:
    import pycolmap

    count, placed = messages.counter("photos placed"), 0

    def add(more: int) -> None:
        nonlocal placed
        placed = min(placed + more, len(photos))
        count(placed, len(photos))

    def begin() -> None:
        nonlocal placed
        placed = 0  # pycolmap may start another model
        add(2)

    models = pycolmap.incremental_mapping(
        work / "database.db",
        images,
        work,
        options,
        initial_image_pair_callback=begin,
        next_image_callback=lambda: add(1),
    )
    return sorted(models.values(), key=lambda m: (-m.num_reg_images(), -m.num_points3D()))
