"""Features and matches by networks, for pycolmap's database (`scene.matching=learned`).

The networks find what photos from distant places have in common better than SIFT does. Each photo
and each pair is computed on one thread, so the bits do not depend on the number of threads.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pycolmap
import torch
import torch.nn.functional as F
from kornia.feature import ALIKED, LightGlue
from numpy.typing import NDArray
from PIL import Image
from torch import Tensor

from framework.scenes.photos.networks import FEATURES, MATCHER, load
from framework.scenes.photos.options import Step, pairs, verification
from framework.scenes.photos.prepare import Photo
from framework.scenes.photos.process import Messages

MOST_FEATURES = 1024  # per photo; twice as many took three times as long on fern
SIDE = 1024  # pixels of the longer side that ALIKED sees

Item = TypeVar("Item")
Computed = TypeVar("Computed")


@dataclass(frozen=True)
class Features:
    """Features of one photo.

    Attributes:
        keypoints: [n, 2] x, y in pixels of the image that the network saw; the centre of the first
            pixel is (0, 0).
        descriptors: [n, 128].
        size: width and height of that image.
    """

    keypoints: Tensor
    descriptors: Tensor
    size: tuple[int, int]


def extract(
    photos: Sequence[Photo], images: Path, database: Path, threads: int, messages: Messages
) -> dict[str, Features]:
    """Find the features of the prepared photos and enter their places; by stored name."""
    network = ALIKED(FEATURES, max_num_keypoints=MOST_FEATURES, detection_threshold=-1)
    network.load_state_dict(load(FEATURES), strict=False)  # buffers of the last image's size
    network.eval()

    def features(photo: Photo) -> Features:
        with torch.inference_mode(), Image.open(images / photo.stored) as image:
            pixels = torch.from_numpy(np.asarray(image.convert("RGB"), np.float32) / 255)
            pixels = pixels.permute(2, 0, 1)[None]
            scale = SIDE / max(photo.width, photo.height)
            if scale < 1:
                pixels = F.interpolate(pixels, scale_factor=scale, mode="bilinear", antialias=True)
            seen = network(pixels)[0]
            return Features(seen.keypoints, seen.descriptors, (pixels.shape[3], pixels.shape[2]))

    computed = _in_order(
        features, photos, threads, messages.counter("photos searched for features")
    )
    with pycolmap.Database.open(str(database)) as opened:
        ids = _ids(opened)
        for photo, one in zip(photos, computed, strict=True):
            scale = np.array([photo.width, photo.height]) / one.size
            places = (one.keypoints.numpy() + 0.5) * scale  # COLMAP's first pixel is at (0.5, 0.5)
            opened.write_keypoints(ids[photo.stored], places.astype(np.float32))
    return {photo.stored: one for photo, one in zip(photos, computed, strict=True)}


def match(
    step: Step,
    features: dict[str, Features],
    photos: Sequence[Photo],
    database: Path,
    threads: int,
    messages: Messages,
) -> None:
    """Match the photos' features and enter the matches that agree with a motion of the camera."""
    network = LightGlue(features=None, input_dim=128)  # type: ignore[arg-type]
    network.load_state_dict(load(MATCHER), strict=False)  # a buffer follows from the options
    network.eval()

    def matches(pair: tuple[int, int]) -> NDArray[np.uint32]:
        both = [features[photos[i].stored] for i in pair]
        with torch.inference_mode():
            images = {
                f"image{k}": {
                    "keypoints": one.keypoints[None],
                    "descriptors": one.descriptors[None],
                    "image_size": torch.tensor([one.size], dtype=torch.float32),
                }
                for k, one in enumerate(both)
            }
            pairs_of_features: NDArray[np.uint32] = (
                network(images)["matches"][0].numpy().astype(np.uint32)
            )
            return pairs_of_features

    chosen = pairs(len(photos))
    computed = _in_order(matches, chosen, threads, messages.counter("pairs of photos compared"))
    lines = []
    with pycolmap.Database.open(str(database)) as opened:
        ids = _ids(opened)
        for (i, j), matched in zip(chosen, computed, strict=True):
            first, second = photos[i].stored, photos[j].stored
            if len(matched):
                opened.write_matches(ids[first], ids[second], matched)
                lines.append(f"{first} {second}")
    if lines:
        listing = database.with_name("pairs.txt")
        listing.write_text("\n".join(lines))
        pycolmap.verify_matches(database, listing, verification(step))


def _ids(database: Any) -> dict[str, int]:
    return {image.name: image.image_id for image in database.read_all_images()}


def _in_order(
    compute: Callable[[Item], Computed],
    items: Sequence[Item],
    threads: int,
    count: Callable[[int, int], None],
) -> list[Computed]:
    """The results for all items, each computed on one thread."""
    results = []
    with ThreadPoolExecutor(threads, initializer=torch.set_num_threads, initargs=(1,)) as pool:
        for result in pool.map(compute, items):
            results.append(result)
            count(len(results), len(items))
    return results
