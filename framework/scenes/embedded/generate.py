"""The embedded scene's images, kept as one npz file in the user's cache.

The file's name hashes the options, the sources of this package and scikit-image's version (it
contains the textures), so a changed scene has another file. A damaged file is generated again.
"""

from __future__ import annotations

import dataclasses
import hashlib
import io
import logging
import zipfile
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from framework.files.cache import cache_dir
from framework.files.whole import write_whole
from framework.scenes.assemble import Shot, Tracks, assemble, intrinsics
from framework.scenes.embedded import rig
from framework.scenes.embedded.vectors import Vector

if TYPE_CHECKING:
    from framework.scenes.embedded.options import EmbeddedOptions
    from framework.types import Scene

log = logging.getLogger(__name__)


class Pictures(NamedTuple):
    """images: [V, H, W, 3] uint8. depths: [V, H, W] float32, z at pixel centres."""

    images: NDArray[np.uint8]
    depths: NDArray[np.float32]

    def digest(self) -> str:
        return hashlib.sha256(self.images.tobytes() + self.depths.tobytes()).hexdigest()


def _positions(options: EmbeddedOptions) -> tuple[list[Vector], list[Vector]]:
    return rig.training_positions(options.n_views), list(rig.TEST_POSITIONS)


def _render(options: EmbeddedOptions) -> Pictures:
    """All views, training first."""
    from framework.compute.parallel import run_blocks
    from framework.scenes.embedded.build import build_world, camera_tiles
    from framework.scenes.embedded.trace import trace_rows

    width, height, samples = options.width, options.height, options.supersampling
    focal = rig.FOCAL_WIDTHS * width
    world = build_world(options.texture, options.gloss, samples)
    train, test = _positions(options)
    images = np.zeros((len(train) + len(test), height, width, 3), dtype=np.uint8)
    depths = np.zeros(images.shape[:3], dtype=np.float32)
    for position, image, depth in zip(train + test, images, depths, strict=True):
        pose = rig.pose(position, options.spread)
        tiles = camera_tiles(pose, focal, width, height)
        run_blocks(
            trace_rows, *world, tiles.members, tiles.size, pose, focal, samples, image, depth
        )
    return Pictures(images, depths)


def _cache_file(options: EmbeddedOptions) -> Path:
    # noise changes the poses that training gets, but not the photos
    exact = dataclasses.replace(options, pose_noise=0.0)
    key = hashlib.sha256(repr(sorted(dataclasses.asdict(exact).items())).encode())
    for source in sorted(Path(__file__).parent.glob("*.py")):
        key.update(source.read_bytes())
    key.update(version("scikit-image").encode())
    return cache_dir() / f"embedded-{key.hexdigest()[:24]}.npz"


def _read(path: Path) -> Pictures | None:
    """The cached pictures; None if there is no file or it is damaged."""
    try:
        with np.load(path, allow_pickle=False) as stored:
            pictures = Pictures(stored["images"], stored["depths"])
            intact = str(stored["digest"]) == pictures.digest()
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        intact = False
    if intact:
        return pictures
    log.warning("%s is damaged and is generated again", path)
    return None


def _pictures(options: EmbeddedOptions) -> Pictures:
    path = _cache_file(options)
    cached = _read(path)
    if cached is not None:
        return cached
    log.info("generating the embedded scene (once, compiling its ray tracer first) ...")
    pictures = _render(options)
    buffer = io.BytesIO()
    np.savez(buffer, images=pictures.images, depths=pictures.depths, digest=pictures.digest())
    write_whole(path, buffer.getvalue())
    return pictures


def _world_to_camera(pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """[4, 4] inverse of the rigid [3, 4] pose, by elementwise arithmetic."""
    viewmat = np.zeros((4, 4))
    viewmat[3, 3] = 1.0
    for k in range(3):
        x, y, z, o = pose[:, k][0], pose[:, k][1], pose[:, k][2], pose[:, 3]
        viewmat[k] = (x, y, z, -(x * o[0] + y * o[1] + z * o[2]))
    return viewmat


def load(options: EmbeddedOptions) -> Scene:
    """Load the scene with the split `rig`."""
    from framework.scenes.embedded.points import sparse_points

    pictures = _pictures(options)
    train, test = _positions(options)
    focal, n = rig.FOCAL_WIDTHS * options.width, len(train)
    K = intrinsics(focal, focal, 0.5 * options.width, 0.5 * options.height)
    poses = np.stack([rig.pose(p, options.spread) for p in train + test])
    names = [f"train{k:02d}" for k in range(n)] + [f"test{k:02d}" for k in range(len(test))]
    noisy = list(poses)
    if options.pose_noise > 0:
        noisy[:n] = rig.perturbed(poses[:n], options.pose_noise / focal)
    shots = [
        Shot(name, _world_to_camera(pose), K, image, depth)
        for name, pose, image, depth in zip(names, noisy, *pictures, strict=True)
    ]
    points = Tracks(*sparse_points(pictures.images[:n], pictures.depths[:n], poses[:n], focal))
    depths = pictures.depths[:n]
    near, far = 0.9 * float(depths.min()), 1.1 * float(depths.max())
    return assemble("embedded", "rig", shots[:n], shots[n:], points, near, far)
