"""One try at the poses: features, matches, and the placing of photos, all by pycolmap.

Work is handed to pycolmap in portions, so that there is progress to tell. Photos and cameras are
entered first, in order: their numbers, and with them all that follows, then do not depend on which
thread is done first.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from framework.scenes.photos.found import Link, Try
from framework.scenes.photos.prepare import Photo
from framework.scenes.photos.steps import (
    SEED,
    Step,
    extraction,
    mapping,
    matching,
    pairs,
    plausible,
    verification,
)
from framework.scenes.photos.telling import Telling

PORTION = 50  # pairs of photos


@dataclass(frozen=True)
class Attempt:
    """model: pycolmap's, None where it found none. held: its focal length was given, not found. The
    rest as in `Found`."""

    model: Any
    held: bool
    placed: dict[str, int]
    groups: list[list[str]]
    features: dict[str, int]
    links: list[Link]
    told: Try


def attempt(
    step: Step, photos: Sequence[Photo], images: Path, work: Path, threads: int, telling: Telling
) -> Attempt:
    """Work with the prepared `photos` in `images`; temporary files go to `work`."""
    import pycolmap

    pycolmap.logging.minloglevel = pycolmap.logging.ERROR.value
    pycolmap.set_random_seed(SEED)
    database = work / "database.db"
    marks = [time.process_time()]
    _enter(photos, images, database)
    _features(step, photos, images, database, threads, telling)
    marks.append(time.process_time())
    _matches(step, photos, database, threads, telling)
    marks.append(time.process_time())
    features, links = _read(database, photos)
    models, held = _models(step, photos, images, work, telling)
    marks.append(time.process_time())
    shown = {photo.stored: photo.name for photo in photos}
    seen = [_seen(model, shown) for model in models]
    placed = seen[0] if seen else {}
    spent = [after - before for before, after in itertools.pairwise(marks)]
    groups = [sorted(set(other) - set(placed)) for other in seen[1:]]
    return Attempt(
        model=models[0] if models else None,
        held=held,
        placed=placed,
        groups=[group for group in groups if len(group) > 1],
        features=features,
        links=links,
        told=Try(step.name, len(placed), *spent),
    )


def _enter(photos: Sequence[Photo], images: Path, database: Path) -> None:
    """Photos and their cameras, of COLMAP's model SIMPLE_RADIAL."""
    import pycolmap

    pycolmap.Database.open(str(database)).close()
    cameras: dict[tuple[object, ...], list[Photo]] = {}
    for photo in photos:
        cameras.setdefault(photo.camera, []).append(photo)
    for group in cameras.values():
        reader = pycolmap.ImageReaderOptions()
        first = group[0]
        if first.focal_px is not None:
            reader.camera_params = f"{first.focal_px},{first.width / 2},{first.height / 2},0"
        names = [photo.stored for photo in group]
        pycolmap.import_images(database, images, pycolmap.CameraMode.SINGLE, names, reader)


def _features(
    step: Step, photos: Sequence[Photo], images: Path, database: Path, threads: int, tell: Telling
) -> None:
    import pycolmap

    tick, portion = tell.ticks("photos searched for features"), max(2 * threads, 4)
    options = extraction(step, threads)
    for start in range(0, len(photos), portion):
        names = [photo.stored for photo in photos[start : start + portion]]
        pycolmap.extract_features(
            database, images, names, pycolmap.CameraMode.PER_IMAGE, extraction_options=options
        )
        tick(min(start + portion, len(photos)), len(photos))


def _matches(
    step: Step, photos: Sequence[Photo], database: Path, threads: int, tell: Telling
) -> None:
    import pycolmap

    chosen, tick = pairs(len(photos)), tell.ticks("pairs of photos compared")
    pairing = pycolmap.ImportedPairingOptions()
    pairing.match_list_path = database.with_name("pairs.txt")
    for start in range(0, len(chosen), PORTION):
        lines = [
            f"{photos[i].stored} {photos[j].stored}" for i, j in chosen[start : start + PORTION]
        ]
        pairing.match_list_path.write_text("\n".join(lines))
        pycolmap.match_image_pairs(database, matching(step, threads), pairing, verification(step))
        tick(min(start + PORTION, len(chosen)), len(chosen))


def _read(database: Path, photos: Sequence[Photo]) -> tuple[dict[str, int], list[Link]]:
    """Features of each photo, and the links between them."""
    import numpy as np
    import pycolmap

    by_name = {photo.stored: photo for photo in photos}
    links = []
    with pycolmap.Database.open(str(database)) as opened:
        entered = {image.image_id: by_name[image.name] for image in opened.read_all_images()}
        places = {i: opened.read_keypoints(i)[:, :2] for i in entered}
        numbers, geometries = opened.read_two_view_geometries()
    for number, geometry in zip(numbers, geometries, strict=True):
        if not len(geometry.inlier_matches):
            continue
        i, j = pycolmap.pair_id_to_image_pair(number)
        a, b = entered[i], entered[j]
        chosen = geometry.inlier_matches
        moved = np.linalg.norm(places[i][chosen[:, 0]] - places[j][chosen[:, 1]], axis=1)
        shift = float(np.median(moved)) / max(a.width, a.height)
        links.append(Link(a.name, b.name, len(chosen), shift))
    return {photo.name: len(places[i]) for i, photo in entered.items()}, links


def _models(
    step: Step, photos: Sequence[Photo], images: Path, work: Path, tell: Telling
) -> tuple[list[Any], bool]:
    """pycolmap's models, the one of most photos first, and whether the focal length was held: with
    the usual thresholds, or with lower ones if these place more."""
    best: tuple[list[Any], bool] = [], False
    for low in (False, True):
        held = False
        found = _mapped(mapping(step, low, held), photos, images, work, tell)
        if found and not _is_plausible(found[0], photos):
            held = True
            found = _mapped(mapping(step, low, held), photos, images, work, tell)
        if found and (not best[0] or _size(found[0]) > _size(best[0][0])):
            best = found, held
        if best[0] and _size(best[0][0]) == len(photos):
            break
    return best


def _is_plausible(model: Any, photos: Sequence[Photo]) -> bool:
    """Whether all its cameras are."""
    exif = {photo.stored: photo.focal_px for photo in photos}
    images = [model.image(i) for i in model.reg_image_ids()]
    return all(
        plausible(
            float(image.camera.params[0]),
            float(image.camera.params[3]),
            max(image.camera.width, image.camera.height),
            exif[image.name],
        )
        for image in images
    )


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
    return sorted(models.values(), key=lambda model: (-_size(model), -model.num_points3D()))


def _size(model: Any) -> int:
    """Photos placed in it."""
    return int(model.num_reg_images())


def _seen(model: Any, shown: dict[str, str]) -> dict[str, int]:
    """Name of each placed photo -> the number of 3D points it sees, in the order of names."""
    images = [model.image(i) for i in model.reg_image_ids()]
    return dict(sorted((shown[image.name], int(image.num_points3D)) for image in images))
