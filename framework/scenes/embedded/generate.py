"""The embedded scene's images, kept as one npz file in the user's cache.

The file's name hashes the options, the sources of this package and scikit-image's version (it
contains the textures), so a changed scene has another file. A damaged file is generated again.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import io
import logging
import zipfile
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from framework.errors import check_option
from framework.files.cache import cache_dir
from framework.files.whole import write_whole
from framework.scenes.assemble import Shot, Tracks, assemble, intrinsics
from framework.scenes.embedded import rig
from framework.scenes.embedded.vectors import Vector
from framework.scenes.layout import check_n_views

if TYPE_CHECKING:
    from framework.types import Scene

log = logging.getLogger(__name__)


class Pictures(NamedTuple):
    """images: [V, H, W, 3] uint8. depths: [V, H, W] float32, z at pixel centres."""

    images: NDArray[np.uint8]
    depths: NDArray[np.float32]

    def digest(self) -> str:
        return hashlib.sha256(self.images.tobytes() + self.depths.tobytes()).hexdigest()


def _positions(options: Embedded) -> tuple[list[Vector], list[Vector]]:
    return rig.training_positions(options.n_views), list(rig.TEST_POSITIONS)


def _render(options: Embedded) -> Pictures:
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


def _cache_file(options: Embedded) -> Path:
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


def _pictures(options: Embedded) -> Pictures:
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


@dataclass(frozen=True)
class Embedded:
    """A ray-traced room in the repository itself, with exact depth.

    The training cameras form a zigzag (protocol `rig`). The eight test cameras are always the same.
    """

    poses_are_exact: ClassVar[bool] = True

    n_views: int = 3  # training views
    width: int = 320  # pixels
    height: int = 240  # pixels
    supersampling: int = 3  # rays per pixel along each axis
    spread: float = 0.35  # metres from the middle of the rig to its outer cameras
    texture: float = 1.0  # factor of all texture contrasts; 0 = textureless
    gloss: float = 1.0  # factor of all highlights and mirrors; 0 = matte
    pose_noise: float = 0.0  # pixels by which the training cameras' poses are wrong

    def __post_init__(self) -> None:
        check = functools.partial(check_option, self, "scene")
        check_n_views("embedded", self.n_views)
        check("n_views", self.n_views <= 64, "at most 64")
        check("width", 32 <= self.width <= 2048, "32 to 2048 pixels")
        check("height", 32 <= self.height <= 2048, "32 to 2048 pixels")
        check("supersampling", 1 <= self.supersampling <= 6, "1 to 6")
        check("spread", 0 < self.spread <= 1, "a number in (0, 1], metres")
        check("texture", 0 <= self.texture <= 2, "a number in [0, 2]")
        check("gloss", 0 <= self.gloss <= 1.3, "a number in [0, 1.3]")
        check("pose_noise", 0 <= self.pose_noise <= 20, "0 to 20 pixels")

    def load(self) -> Scene:
        """Load the scene from the cache, or generate it (a few seconds)."""
        from framework.scenes.embedded.points import sparse_points

        pictures = _pictures(self)
        train, test = _positions(self)
        focal, n = rig.FOCAL_WIDTHS * self.width, len(train)
        K = intrinsics(focal, focal, 0.5 * self.width, 0.5 * self.height)
        poses = np.stack([rig.pose(p, self.spread) for p in train + test])
        names = [f"train{k:02d}" for k in range(n)] + [f"test{k:02d}" for k in range(len(test))]
        noisy = list(poses)
        if self.pose_noise > 0:
            noisy[:n] = rig.perturbed(poses[:n], self.pose_noise / focal)
        shots = [
            Shot(name, _world_to_camera(pose), K, image, depth)
            for name, pose, image, depth in zip(names, noisy, *pictures, strict=True)
        ]
        points = Tracks(*sparse_points(pictures.images[:n], pictures.depths[:n], poses[:n], focal))
        depths = pictures.depths[:n]
        near, far = 0.9 * float(depths.min()), 1.1 * float(depths.max())
        return assemble("embedded", "rig", shots[:n], shots[n:], points, near, far)
