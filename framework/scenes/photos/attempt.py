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

from framework.scenes.photos.advice import stands_still
from framework.scenes.photos.found import Link, Overruled, Try
from framework.scenes.photos.placing import Placing, place
from framework.scenes.photos.prepare import Photo
from framework.scenes.photos.steps import (
    SEED,
    Step,
    extraction,
    matching,
    pairs,
    verification,
)
from framework.scenes.photos.telling import Telling

PORTION = 50  # pairs of photos


@dataclass(frozen=True)
class Attempt:
    """model: pycolmap's, None where it found none. held, overruled: see `Placing`. The rest as in
    `Found`."""

    model: Any
    held: bool
    overruled: Overruled | None
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
    # from one place no model comes, or one that is wrong
    still = stands_still(links)
    found = Placing([]) if still else place(step, photos, images, work, telling)
    marks.append(time.process_time())
    shown = {photo.stored: photo.name for photo in photos}
    seen = [_seen(model, shown) for model in found.models]
    placed = seen[0] if seen else {}
    spent = [after - before for before, after in itertools.pairwise(marks)]
    groups = [sorted(set(other) - set(placed)) for other in seen[1:]]
    return Attempt(
        model=found.models[0] if found.models else None,
        held=found.held,
        overruled=found.overruled,
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
    kinds = pycolmap.TwoViewGeometryConfiguration
    homographies = {int(kinds.PANORAMIC), int(kinds.PLANAR_OR_PANORAMIC)}
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
        flat = geometry.config in homographies
        links.append(Link(a.name, b.name, len(chosen), shift, flat))
    return {photo.name: len(places[i]) for i, photo in entered.items()}, links


def _seen(model: Any, shown: dict[str, str]) -> dict[str, int]:
    """Name of each placed photo -> the number of 3D points it sees, in the order of names."""
    images = [model.image(i) for i in model.reg_image_ids()]
    return dict(sorted((shown[image.name], int(image.num_points3D)) for image in images))
