"""Whether the text files of a COLMAP model are whole and refer to each other rightly.

Layout (COLMAP's documentation, "Output format"; `#` opens a comment): a camera takes a line of id,
model, width, height and parameters; an image two, of id, quaternion, translation, camera id and
name, and of x y point-id triples (may be empty); a point one, of id, xyz, rgb, error and pairs of
image id and index into that image's triples.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

from framework.errors import UserError, require
from framework.files.limits import MODEL_BYTES
from framework.files.opened import read_text
from framework.scenes.cameras import check_quaternion

log = logging.getLogger(__name__)

INTEGER = re.compile(r"-?\d{1,18}", re.ASCII)
NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|[+-]?(inf|nan)", re.ASCII | re.I)


def check_text(files: Sequence[Path]) -> dict[int, str]:
    """The names of the images by id, which pycolmap ends at their first blank. Raises UserError
    unless cameras.txt, images.txt and, if it exists, points3D.txt are sound."""
    cameras = _cameras(files[0])
    points, names = _images(files[1], cameras)
    for file in files[2:]:
        _points(file, points)
    return names


def _cameras(path: Path) -> set[int]:
    ids = set()
    for number, row, _ in _records(path, "cameras"):
        good = len(row) >= 7 and _integers([row[0], *row[2:4]]) and _numbers(row[4:])
        _require(good, path, number, "id, model, width, height and its parameters", row)
        _require(int(row[0]) not in ids, path, number, "each camera once", row)
        ids.add(int(row[0]))
    return ids


def _images(path: Path, cameras: set[int]) -> tuple[dict[int, int], dict[int, str]]:
    """Of the image ids: the number of 2D points, and the name."""
    points: dict[int, int] = {}
    names: dict[int, str] = {}
    rows = _records(path, "images", pairs=True)
    for number, row, line in rows:
        good = len(row) >= 10 and _integers([row[0], row[8]]) and _numbers(row[1:8])
        _require(good, path, number, "id, 7 numbers of the pose, camera id and name", row)
        image, camera, name = int(row[0]), int(row[8]), line.split(maxsplit=9)[9].rstrip()
        known = camera in cameras and image not in points and name not in names.values()
        _require(known, path, number, "each image once, with a camera of cameras.txt", row)
        check_quaternion([float(word) for word in row[1:5]], f"{path}: image '{name[:80]}'")
        number, triples, _ = next(rows, (number, ["missing"], ""))
        good = len(triples) % 3 == 0 and _integers(triples[2::3])
        good = good and _numbers(triples[0::3]) and _numbers(triples[1::3])
        _require(good, path, number, "triples of x, y and point id", triples)
        points[image] = len(triples) // 3
        names[image] = name
    return points, names


def _points(path: Path, images: dict[int, int]) -> None:
    ids = set()
    for number, row, _ in _records(path, "points"):
        good = len(row) >= 8 and len(row) % 2 == 0 and _integers([row[0], *row[4:7], *row[8:]])
        good = good and _numbers([*row[1:4], row[7]])
        _require(good, path, number, "id, xyz, rgb, error and its track", row)
        track = zip(map(int, row[8::2]), map(int, row[9::2]), strict=True)
        within = all(0 <= index < images.get(image, 0) for image, index in track)
        _require(within, path, number, "a track of images in images.txt", row)
        _require(int(row[0]) not in ids, path, number, "each point once", row)
        ids.add(int(row[0]))


def _records(path: Path, noun: str, pairs: bool = False) -> Iterator[tuple[int, list[str], str]]:
    """(line number, words, line) of the lines that are no comment; blank ones only where the format
    gives them a meaning (`pairs`). As many records as the header says, if it does."""
    text = read_lines(path)
    lines = text.removesuffix("\n").split("\n")
    found = 0
    for number, line in enumerate(lines, start=1):
        words = line.split()
        if line.startswith("#") or (not words and not (pairs and found % 2)):
            continue
        found += 1
        yield number, words, line
    said = re.search(rf"^# Number of {noun}: (\d{{1,18}})", "\n".join(lines[:5]), re.MULTILINE)
    records = -(-found // 2) if pairs else found
    expected = int(said.group(1)) if said else records
    require(
        records == expected,
        f"{path}: expected {expected} records, got {records}; the file is truncated or damaged;"
        " copy it again or rebuild the model",
    )
    if text and not text.endswith("\n"):
        log.warning(
            f"{path}: the last line has no newline; if the file is truncated, copy it again, else"
            " add one"
        )


def read_lines(path: Path) -> str:
    """Read a text file with the line ends of Unix, without a byte order mark."""
    return read_text(path, MODEL_BYTES).replace("\r\n", "\n")


def _integers(words: Sequence[str]) -> bool:
    return all(INTEGER.fullmatch(word) for word in words)


def _numbers(words: Sequence[str]) -> bool:
    return all(len(word) < 400 and NUMBER.fullmatch(word) for word in words)


def _require(good: bool, path: Path, number: int, expected: str, row: Sequence[str]) -> None:
    if not good:
        raise UserError(
            f"{path}: expected {expected} in line {number}, got '{' '.join(row[:12])[:80]}'; the"
            " file is damaged, copy it again or rebuild the model"
        )
