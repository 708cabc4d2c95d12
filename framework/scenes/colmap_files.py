"""Strict reader of a COLMAP sparse model, whose files may come from strangers.

The layouts are in COLMAP's documentation, "Output format".

Binary, little-endian; each file starts with a uint64 count:

    cameras   id int32, model int32, width and height uint64, the model's float64 parameters
    images    id int32, quaternion and translation 7 float64, camera id int32, name ended by 0,
              uint64 n, n x (x, y float64, point id int64)
    points3D  id uint64, xyz 3 float64, rgb 3 uint8, error float64, uint64 n,
              n x (image id int32, index int32 of that image's n)

Text, where `#` starts a comment; an image is two lines, of which the second may be empty:

    cameras   id, model, width, height, parameters
    images    id, quaternion, translation, camera id, name
              x, y, point id, ...
    points3D  id, xyz, rgb, error, track

Rigs and frames of newer models repeat the poses and are not read.
"""

from __future__ import annotations

import logging
import re
import struct
from array import array
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from framework.errors import require
from framework.files.limits import MODEL_BYTES, MODEL_CELLS
from framework.files.opened import is_file, read_bytes, read_text, reading
from framework.files.paths import inside
from framework.scenes.assemble import Tracks
from framework.scenes.cameras import near_points

log = logging.getLogger(__name__)

STEMS = ("cameras", "images", "points3D")
MODELS = {  # camera model -> number of its parameters, in the order of COLMAP's ids
    **{"SIMPLE_PINHOLE": 3, "PINHOLE": 4, "SIMPLE_RADIAL": 4, "RADIAL": 5, "OPENCV": 8},
    **{"OPENCV_FISHEYE": 8, "FULL_OPENCV": 12, "FOV": 5, "SIMPLE_RADIAL_FISHEYE": 4},
    **{"RADIAL_FISHEYE": 5, "THIN_PRISM_FISHEYE": 12, "RAD_TAN_THIN_PRISM_FISHEYE": 16},
    **{"SIMPLE_DIVISION": 4, "DIVISION": 5, "SIMPLE_FISHEYE": 3, "FISHEYE": 4},
}
DAMAGED = "the file is damaged; copy it again or rebuild the model"


class Camera(NamedTuple):
    """A camera as it is written; see `colmap_model` for the order of `params`."""

    id: int
    model: str
    width: int
    height: int
    params: tuple[float, ...]


class Image(NamedTuple):
    """A registered image.

    Attributes:
        pose: quaternion wxyz and translation, world-to-camera.
        points: number of its 2D points.
    """

    id: int
    pose: tuple[float, ...]
    camera: int
    name: str
    points: int


class Point(NamedTuple):
    """A 3D point.

    Attributes:
        track: [n, 2] image id, and index of the image's 2D point.
    """

    id: int
    xyz: tuple[float, ...]
    rgb: tuple[int, ...]
    track: NDArray[np.int64]


def read_files(folder: Path) -> tuple[dict[int, Camera], list[Image], Tracks]:
    """Read the model in `folder`; one of known poses may lack `points3D`.

    Returns:
        Its cameras by id, its images sorted by name, and its points.

    Raises:
        UserError: a file is missing or damaged.
    """
    files = _files(folder)
    readers = [_Binary(file) if file.suffix == ".bin" else _Text(file) for file in files]
    cameras: dict[int, Camera] = {}
    for camera in readers[0].cameras():
        _check(camera.id not in cameras, readers[0], "each camera once", camera.id)
        cameras[camera.id] = camera
    images: dict[int, Image] = {}
    names: set[str] = set()
    for image in readers[1].images():
        once = image.id not in images and image.name not in names
        expected = "each image once, with a camera that is listed"
        _check(once and image.camera in cameras, readers[1], expected, image.name[:80])
        images[image.id] = image
        names.add(image.name)
    in_order = sorted(images.values(), key=lambda image: image.name)
    tracks = _tracks(readers[2], in_order) if len(readers) == len(STEMS) else Tracks()
    return cameras, in_order, tracks


def _tracks(reader: _Binary | _Text, images: Sequence[Image]) -> Tracks:
    """The points in the order of their ids, collected in few bytes per point."""
    n_points = {image.id: image.points for image in images}
    column = {image.id: k for k, image in enumerate(images)}
    ids: dict[int, int] = {}  # point id -> row
    xyz, rgb, lengths, columns = array("d"), bytearray(), array("q"), array("q")
    for point in reader.points():
        image_ids, indices = point.track.T.tolist()
        pairs = zip(image_ids, indices, strict=True)
        listed = all(0 <= index < n_points.get(i, 0) for i, index in pairs)
        expected = "each point once, with a track of listed images"
        _check(listed and point.id not in ids, reader, expected, point.id)
        ids[point.id] = len(ids)
        xyz.extend(point.xyz)
        rgb.extend(point.rgb)
        lengths.append(len(image_ids))
        columns.extend(column[i] for i in image_ids)
    cells = len(ids) * len(images)
    require(
        cells <= MODEL_CELLS,
        f"{reader.where}: expected at most {MODEL_CELLS:,} points x images, got {cells:,}; filter"
        " the points or split the model",
    )
    seen = np.zeros((len(ids), len(images)), dtype=bool)
    seen[np.repeat(np.arange(len(ids)), np.array(lengths)), np.array(columns)] = True
    places, colours = np.array(xyz).reshape(-1, 3), np.frombuffer(rgb, np.uint8).reshape(-1, 3)
    order = np.array([ids[i] for i in sorted(ids)], np.intp)
    order = order[near_points(places[order])]
    return Tracks(places[order], colours[order], seen[order])


def _files(folder: Path) -> list[Path]:
    """The files of the model, all of one suffix: .bin, or .txt if it is newer, as after the text
    was edited, which is logged as a warning."""
    binary, text = (
        [file for stem in STEMS if is_file(file := folder / f"{stem}{suffix}")]
        for suffix in (".bin", ".txt")
    )
    files = max(
        (binary, text), key=lambda of: (len(of), max((f.stat().st_mtime for f in of), default=0))
    )
    stems = [file.stem for file in files]
    require(  # a model of known poses may lack points3D
        len(files) > 1 and stems == [*STEMS[: len({f.stem for f in binary + text})]],
        f"{folder}: expected cameras, images and points3D, all as .bin or all as .txt, got"
        f" {', '.join(file.name for file in binary + text) or 'none'}; copy the whole model",
    )
    if files is text and len(binary) == len(text):
        log.warning(
            f"{folder}: the model is there as .bin and as .txt; the .txt files are newer and are"
            " read; remove the files that are out of date"
        )
    return [inside(folder, file.name) for file in files]


def _check(good: bool, reader: _Binary | _Text, expected: str, got: object) -> None:
    require(good, f"{reader.where}: expected {expected}, got '{got}'; {DAMAGED}")


class _Binary:
    """Reads a binary file; a record that reaches beyond its end raises UserError."""

    def __init__(self, path: Path) -> None:
        self.where, self.data, self.at = str(path), read_bytes(path, MODEL_BYTES), 0

    def cameras(self) -> Iterator[Camera]:
        for _ in range(self._take("<Q")[0]):
            camera, model, width, height = self._take("<iiQQ")
            _check(0 <= model < len(MODELS), self, f"a camera model id below {len(MODELS)}", model)
            name = [*MODELS][model]
            yield Camera(camera, name, width, height, self._take(f"<{MODELS[name]}d"))
        self._finish()

    def images(self) -> Iterator[Image]:
        for _ in range(self._take("<Q")[0]):
            number, *pose = self._take("<i7d")
            (camera,) = self._take("<i")
            name = self._text()
            (n,) = self._take("<Q")
            self._skip(24 * n)
            yield Image(number, tuple(pose), camera, name, n)
        self._finish()

    def points(self) -> Iterator[Point]:
        for _ in range(self._take("<Q")[0]):
            number, x, y, z, red, green, blue, _, n = self._take("<Q3d3BdQ")
            start = self.at
            self._skip(8 * n)
            track = np.frombuffer(self.data, "<i4", 2 * n, start).reshape(-1, 2)
            yield Point(number, (x, y, z), (red, green, blue), track)
        self._finish()

    def _take(self, layout: str) -> tuple:
        """The values of a struct layout."""
        start = self.at
        self._skip(struct.calcsize(layout))
        return struct.unpack_from(layout, self.data, start)

    def _skip(self, n: int) -> None:
        end = self.at + n
        require(
            end <= len(self.data),
            f"{self.where}: expected at least {end} bytes, got {len(self.data)}: the file is"
            " truncated or damaged; copy it again or rebuild the model",
        )
        self.at = end

    def _text(self) -> str:
        """A string that ends with a zero byte."""
        end = self.data.find(b"\0", self.at)
        name = self.data[self.at : max(end, self.at)]
        self._skip(end + 1 - self.at if end >= 0 else len(self.data) + 1)
        with reading(self.where, f"an image's name in UTF-8, not {name[:60]!r}", DAMAGED):
            text = name.decode("utf-8")
        return text

    def _finish(self) -> None:
        rest = len(self.data) - self.at
        require(rest == 0, f"{self.where}: expected its end, got {rest} more bytes; {DAMAGED}")


class _Text:
    """Reads a text file; `where` also names the line."""

    def __init__(self, path: Path) -> None:
        self.path = self.where = str(path)
        text = read_text(path, MODEL_BYTES)
        self.lines = text.replace("\r\n", "\n").removesuffix("\n").split("\n")
        if text and not text.endswith("\n"):
            log.warning(f"{path}: the last line has no newline; if it is truncated, copy it again")

    def cameras(self) -> Iterator[Camera]:
        for line in self._records("cameras"):
            with self._damage(line):
                number, model, width, height, *params = line.split()
                camera = Camera(int(number), model, int(width), int(height), _floats(params))
            yield camera

    def images(self) -> Iterator[Image]:
        lines = self._records("images", paired=True)
        for line in lines:
            with self._damage(line):
                *words, name = line.split(maxsplit=9)
                number, *pose, camera = words
                if len(pose) != 7:
                    raise ValueError("expected a pose of 7 numbers")
                image = Image(int(number), _floats(pose), int(camera), name.rstrip(), 0)
            triples = next(lines, "missing").split()
            with self._damage(" ".join(triples[:12])):
                x, y, points = (triples[k::3] for k in range(3))
                if not len(_floats(x)) == len(_floats(y)) == len([*map(int, points)]):
                    raise ValueError("expected triples of x, y and point id")
            yield image._replace(points=len(points))

    def points(self) -> Iterator[Point]:
        for line in self._records("points"):
            with self._damage(line):
                number, x, y, z, red, green, blue, error, *track = line.split()
                float(error)
                rgb = tuple(bytes((int(red), int(green), int(blue))))
                ids = np.array([int(word) for word in track], np.int64)
                point = Point(int(number), _floats((x, y, z)), rgb, ids.reshape(-1, 2))
            yield point

    def _records(self, noun: str, paired: bool = False) -> Iterator[str]:
        """The lines that are no comments; blank ones only as the second line of a pair. There must
        be as many records as the header says, if it does."""
        count = 0
        for number, line in enumerate(self.lines, start=1):
            if line.startswith("#") or not (line.strip() or (paired and count % 2)):
                continue
            count += 1
            self.where = f"{self.path}: line {number}"
            yield line
        header = re.search(rf"^# Number of {noun}: (\d{{1,18}})", "\n".join(self.lines[:5]), re.M)
        records = -(-count // 2) if paired else count
        expected = int(header[1]) if header else records
        require(
            records == expected,
            f"{self.path}: expected {expected} records, got {records}; the file is truncated or"
            " damaged; copy it again or rebuild the model",
        )

    def _damage(self, line: str) -> AbstractContextManager[None]:
        """Raise UserError if the line does not hold the values that its record has."""
        return reading(self.where, f"the values of COLMAP's format in '{line[:80]}'", DAMAGED)


def _floats(words: Sequence[str]) -> tuple[float, ...]:
    return tuple(map(float, words))
