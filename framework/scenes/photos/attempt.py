"""One attempt at the poses: features, matches and placing by pycolmap; see also `learned`.

pycolmap gets its work in portions, so that progress can be shown. Photos and cameras are entered
first and in order: their ids, and all results, then do not depend on the order of threads.
"""

import itertools
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from framework.scenes.photos.advice import stands_still
from framework.scenes.photos.options import SEED, Step, extraction, matching, pairs, verification
from framework.scenes.photos.placing import Placing, place
from framework.scenes.photos.prepare import Photo
from framework.scenes.photos.process import Messages
from framework.scenes.photos.result import Link, Poses, Try

PORTION = 50  # pairs of photos


@dataclass(frozen=True, kw_only=True)
class Attempt(Poses):
    """model: pycolmap's, None if there is none."""

    model: Any = None


def attempt(
    step: Step, photos: Sequence[Photo], images: Path, work: Path, threads: int, messages: Messages
) -> tuple[Attempt, Try]:
    """Place the prepared `photos` in `images`; temporary files go to `work`."""
    import pycolmap

    pycolmap.logging.minloglevel = pycolmap.logging.ERROR.value
    pycolmap.set_random_seed(SEED)
    database = work / "database.db"
    marks = [time.process_time()]
    _enter(photos, images, database)
    if step.learned:
        from framework.scenes.photos import learned

        seen = learned.extract(photos, images, database, threads, messages)
        marks.append(time.process_time())
        learned.match(step, seen, photos, database, threads, messages)
    else:
        _extract(step, photos, images, database, threads, messages)
        marks.append(time.process_time())
        _match(step, photos, database, threads, messages)
    marks.append(time.process_time())
    features, links = _read(database, photos)
    # from one place there is no model, or a wrong one
    still = stands_still(links)
    placing = Placing() if still else place(step, photos, images, work, messages)
    marks.append(time.process_time())
    names = {photo.stored: photo.name for photo in photos}
    placed, *others = [_points_seen(model, names) for model in placing.models] or [{}]
    groups = [sorted(set(other) - set(placed)) for other in others]
    seconds = [after - before for before, after in itertools.pairwise(marks)]
    groups = [group for group in groups if len(group) > 1]
    model = placing.models[0] if placing.models else None
    poses = placed, groups, features, links, placing.held, placing.overruled
    return Attempt(*poses, model=model), Try(step.name, len(placed), *seconds)


def _enter(photos: Sequence[Photo], images: Path, database: Path) -> None:
    """Enter photos and their cameras, of COLMAP's model SIMPLE_RADIAL."""
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


def _extract(
    step: Step,
    photos: Sequence[Photo],
    images: Path,
    database: Path,
    threads: int,
    messages: Messages,
) -> None:
    import pycolmap

    count, portion = messages.counter("photos searched for features"), max(2 * threads, 4)
    options = extraction(step, threads)
    for start in range(0, len(photos), portion):
        names = [photo.stored for photo in photos[start : start + portion]]
        pycolmap.extract_features(
            database, images, names, pycolmap.CameraMode.PER_IMAGE, extraction_options=options
        )
        count(min(start + portion, len(photos)), len(photos))


def _match(
    step: Step, photos: Sequence[Photo], database: Path, threads: int, messages: Messages
) -> None:
    import pycolmap

    chosen, count = pairs(len(photos)), messages.counter("pairs of photos compared")
    pairing = pycolmap.ImportedPairingOptions()
    pairing.match_list_path = database.with_name("pairs.txt")
    for start in range(0, len(chosen), PORTION):
        portion = chosen[start : start + PORTION]
        lines = [f"{photos[i].stored} {photos[j].stored}" for i, j in portion]
        pairing.match_list_path.write_text("\n".join(lines))
        pycolmap.match_image_pairs(database, matching(step, threads), pairing, verification(step))
        count(min(start + PORTION, len(chosen)), len(chosen))


def _read(database: Path, photos: Sequence[Photo]) -> tuple[dict[str, int], list[Link]]:
    """The number of features of each photo, and the links between photos."""
    import numpy as np
    import pycolmap

    by_name = {photo.stored: photo for photo in photos}
    kinds = pycolmap.TwoViewGeometryConfiguration
    homographies = {int(kinds.PANORAMIC), int(kinds.PLANAR_OR_PANORAMIC)}
    links = []
    with pycolmap.Database.open(str(database)) as opened:
        entered = {image.image_id: by_name[image.name] for image in opened.read_all_images()}
        places = {i: opened.read_keypoints(i)[:, :2] for i in entered}
        pair_ids, geometries = opened.read_two_view_geometries()
    for pair_id, geometry in zip(pair_ids, geometries, strict=True):
        matches = geometry.inlier_matches
        if not len(matches):
            continue
        i, j = pycolmap.pair_id_to_image_pair(pair_id)
        a, b = entered[i], entered[j]
        distances = np.linalg.norm(places[i][matches[:, 0]] - places[j][matches[:, 1]], axis=1)
        shift = float(np.median(distances)) / max(a.width, a.height)
        links.append(Link(a.name, b.name, len(matches), shift, geometry.config in homographies))
    return {photo.name: len(places[i]) for i, photo in entered.items()}, links


def _points_seen(model: Any, names: dict[str, str]) -> dict[str, int]:
    """Name of each placed photo -> number of 3D points it sees, sorted by name."""
    images = [model.image(i) for i in model.reg_image_ids()]
    return dict(sorted((names[image.name], int(image.num_points3D)) for image in images))
