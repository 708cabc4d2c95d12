"""Whether the files of a COLMAP model are whole and refer to each other rightly.

Layout of the binaries (COLMAP's documentation, "Output format"; little-endian): each file opens
with a uint64 count. cameras: id int32, model int32, width and height uint64, the model's float64
parameters. images: id int32, quaternion and translation 7 float64, camera id int32, name ended by
0, uint64 n, n x (x, y float64, point id int64). points3D: id uint64, xyz 3 float64, rgb 3 uint8,
error float64, uint64 n, n x (image id int32, point index int32).
"""

from __future__ import annotations

import logging
import struct
from pathlib import Path

from framework.errors import UserError, require
from framework.files.limits import MODEL_BYTES
from framework.files.opened import is_file, read_bytes
from framework.files.paths import inside
from framework.scenes.cameras import check_quaternion
from framework.scenes.colmap_text import check_text

log = logging.getLogger(__name__)

PARAMETERS = (3, 4, 4, 5, 8, 8, 12, 5, 4, 5, 12, 16, 4, 5, 3, 4)  # by COLMAP's camera model id
STEMS = ("cameras", "images", "points3D")


class _Reader:
    """Walks a binary file; whatever lies outside it raises UserError."""

    def __init__(self, path: Path) -> None:
        self.path, self.data, self.at = path, read_bytes(path, MODEL_BYTES), 0

    def take(self, layout: str) -> tuple:
        """The values of a struct layout at the current place."""
        start = self.at
        self.skip(struct.calcsize(layout))
        return struct.unpack_from(layout, self.data, start)

    def skip(self, n: int) -> None:
        """Move n bytes on."""
        if self.at + n > len(self.data):
            raise UserError(
                f"{self.path}: expected at least {self.at + n} bytes, got {len(self.data)}: the"
                " file is truncated or damaged; copy it again or rebuild the model"
            )
        self.at += n

    def text(self) -> str:
        """A string ended by a zero byte."""
        end = self.data.find(b"\0", self.at)
        name = self.data[self.at : max(end, self.at)]
        self.skip(max(end + 1 - self.at, 0) or len(self.data) + 1)
        try:
            return name.decode("utf-8")
        except UnicodeDecodeError:
            raise UserError(
                f"{self.path}: expected image names in UTF-8, got {name[:60]!r}; rename the image"
                " or rebuild the model"
            ) from None

    def finish(self) -> None:
        """Nothing may follow the last record."""
        rest = len(self.data) - self.at
        require(rest == 0, f"{self.path}: expected its end, got {rest} more bytes; it is damaged")


def _cameras(path: Path) -> set[int]:
    reader, ids = _Reader(path), set()
    for _ in range(reader.take("<Q")[0]):
        camera, model, _, _ = reader.take("<iiQQ")
        require(
            0 <= model < len(PARAMETERS),
            f"{path}: expected a camera model id from 0 to {len(PARAMETERS) - 1}, got {model};"
            " the file is damaged or newer than this reader",
        )
        reader.skip(8 * PARAMETERS[model])
        require(
            camera not in ids, f"{path}: expected each camera once, got {camera} twice; rebuild it"
        )
        ids.add(camera)
    reader.finish()
    return ids


def _images(path: Path, cameras: set[int]) -> dict[int, int]:
    """image id -> number of its 2D points."""
    reader, points, names = _Reader(path), {}, set()
    for _ in range(reader.take("<Q")[0]):
        image, *pose = reader.take("<i7d")
        (camera,) = reader.take("<i")
        name = reader.text()
        (n,) = reader.take("<Q")
        reader.skip(24 * n)
        require(
            camera in cameras and image not in points and name not in names,
            f"{path}: expected image '{name[:80]}' to be listed once with a camera of cameras.bin,"
            f" got id {image} with camera {camera}; rebuild the model",
        )
        check_quaternion(pose[:4], f"{path}: image '{name[:80]}'")
        points[image] = n
        names.add(name)
    reader.finish()
    return points


def _points(path: Path, images: dict[int, int]) -> None:
    reader, ids = _Reader(path), set()
    for _ in range(reader.take("<Q")[0]):
        point = reader.take("<Q3d3Bd")[0]
        (n,) = reader.take("<Q")
        start = reader.at
        reader.skip(8 * n)
        track = struct.iter_unpack("<ii", reader.data[start : reader.at])
        require(
            point not in ids and all(0 <= i < images.get(image, 0) for image, i in track),
            f"{path}: expected each point once, with a track of images in images.bin, got"
            f" otherwise for point {point}; rebuild the model",
        )
        ids.add(point)
    reader.finish()


def _order(folder: Path) -> tuple[str, str]:
    """The suffixes of model files, the preferred one first: .bin, or .txt if it is newer, as after
    the text was edited. Logs a warning in the second case."""
    newest = {
        suffix: max(file.stat().st_mtime for file in files)
        for suffix in (".bin", ".txt")
        if all(map(is_file, files := [folder / f"{stem}{suffix}" for stem in STEMS]))
    }
    if len(newest) < 2 or newest[".txt"] <= newest[".bin"]:
        return ".bin", ".txt"
    log.warning(
        f"{folder}: the model is there as .bin and as .txt; the .txt files are newer and are read;"
        " remove the files that are out of date"
    )
    return ".txt", ".bin"


def check(folder: Path) -> tuple[list[Path], dict[int, str]]:
    """Check the files of a model; a model of known poses may lack `points3D`.

    Returns:
        The cameras, images and points3D files that exist, as .bin or .txt, of both the newer ones;
        and, of text files, the names of the images by id.

    Raises:
        UserError: a file is missing or damaged.
    """
    for suffix in _order(folder):
        files = [folder / f"{stem}{suffix}" for stem in STEMS]
        missing = [file.name for file in files[:2] if not is_file(file)]
        if not missing:
            break
    other = f"points3D{'.txt' if suffix == '.bin' else '.bin'}"
    if not is_file(files[2]):
        missing += [files[2].name] if missing or is_file(folder / other) else []
        files = files[:2]
    require(
        not missing,
        f"{folder}: expected cameras, images and points3D as .bin or .txt, missing"
        f" {', '.join(missing)}; copy the whole model",
    )
    for file in files:
        inside(folder, file.name)
    if suffix == ".txt":
        return files, check_text(files)
    images = _images(files[1], _cameras(files[0]))
    if len(files) == len(STEMS):
        _points(files[2], images)
    return files, {}
