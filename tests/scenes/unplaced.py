"""Photos without poses, and a result of the search that was made by hand."""

from pathlib import Path

import numpy as np
from PIL import Image

from framework.compute.rng import stream
from framework.scenes.photos import process
from framework.scenes.photos.result import Link, Result
from framework.scenes.photos.source import Source, find_source
from framework.types import Scene
from tests.built import load_scene

SIDE, FRAMES = 1200, 40


def load(folder: Path, **options: object) -> Scene:
    return load_scene("photos", {"path": str(folder), **options})


def source_of(folder: Path) -> Source:
    return find_source(str(folder), SIDE, FRAMES)


def kept(room: Path) -> Path:
    return process.poses_folder(source_of(room))


def noise_photos(folder: Path, n: int = 3) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for i in range(n):
        pixels = stream(i, "tests/photos").integers(0, 256, (48, 64, 3), dtype=np.uint8)
        Image.fromarray(pixels).save(folder / f"n{i}.png")
    return folder


NAMES = [f"p{k:02d}.jpg" for k in range(12)]
FOUND = Result(
    photos=NAMES,
    placed=dict.fromkeys(NAMES, 200),
    groups=[],
    features=dict.fromkeys(NAMES, 800),
    links=[
        Link(a, b, 100 - 10 * abs(i - j), 0.05 * abs(i - j))
        for j, b in enumerate(NAMES)
        for i, a in enumerate(NAMES[:j])
        if abs(i - j) < 4
    ],
    tries=[],
    seconds=9.0,
)
