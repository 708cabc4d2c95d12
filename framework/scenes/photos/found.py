"""What is known of the photos once poses were looked for: `poses.json` beside the model."""

from __future__ import annotations

import builtins
import dataclasses
import json
import math
import types
import typing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from framework.errors import UserError
from framework.files.documents import read_json
from framework.files.limits import TEXT_BYTES
from framework.files.whole import write_whole

FILE = "poses.json"


@dataclass(frozen=True)
class Link:
    """Two photos with features in common that agree with one motion of the camera. shift: median
    distance between the two places of a feature, in shares of the photos' longer side. flat: a
    homography explains all of them, so they tell no depth: the camera has only turned, or what it
    sees is flat."""

    first: str
    second: str
    matches: int
    shift: float
    flat: bool = False


@dataclass(frozen=True)
class Overruled:
    """EXIF's focal length that was not taken and the one that was, in pixels of the prepared photo,
    with the mean reprojection errors of both in pixels; None: EXIF's placed fewer photos."""

    exif_px: float
    found_px: float
    exif_error_px: float | None
    found_error_px: float


@dataclass(frozen=True)
class Try:
    """One step of trying: how many photos found a place in it; CPU seconds, all threads together,
    of its stages."""

    step: str
    placed: int
    features_cpu_s: float
    matching_cpu_s: float
    mapping_cpu_s: float


@dataclass(frozen=True)
class Found:
    """photos: all, in order. placed: name -> 3D points seen, of those with a pose. groups: photos
    that found places among themselves, apart from the scene. features: name -> their number.
    held: the focal length was given, as the photos do not tell it. overruled: EXIF's, which the
    photos contradict. reduced: whether photos were
    larger than wanted. copies: see `Source`."""

    photos: list[str]
    placed: dict[str, int]
    groups: list[list[str]]
    features: dict[str, int]
    links: list[Link]
    tries: list[Try]
    seconds: float
    held: bool = False
    video: bool = False
    reduced: bool = False
    copies: dict[str, str] = field(default_factory=dict)
    overruled: Overruled | None = None

    @property
    def left_out(self) -> list[str]:
        """The photos without a pose."""
        return [name for name in self.photos if name not in self.placed]


def write_found(folder: Path, found: Found) -> None:
    """Into `poses.json` of `folder`."""
    write_whole(folder / FILE, json.dumps(dataclasses.asdict(found), indent=1))


def read_found(folder: Path) -> Found:
    """From `poses.json` of `folder`. Raises UserError for a damaged one."""
    path = folder / FILE
    try:
        values = read_json(path, TEXT_BYTES)
        values["links"] = [Link(**link) for link in values["links"]]
        values["tries"] = [Try(**attempt) for attempt in values["tries"]]
        if values.get("overruled") is not None:
            values["overruled"] = Overruled(**values["overruled"])
        found = Found(**values)
        if not _sound(found):
            raise ValueError("values that no search writes")
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise UserError(
            f"{path}: expected the kept result of a search for poses, got a damaged one"
            f" ({type(error).__name__}); remove the folder {folder.name}"
        ) from error
    return found


def _sound(found: Found) -> bool:
    """Whether all values are of their types, and names those of files beside each other."""
    parts = (found, *found.links, *found.tries, *filter(None, [found.overruled]))
    return (
        all(
            _fits(getattr(part, name), hint)
            for part in parts
            for name, hint in typing.get_type_hints(type(part)).items()
        )
        and len(found.placed) > 0
        and found.placed.keys() <= {*found.photos}
        and not any("/" in name or name in ("", ".", "..") for name in found.photos)
        and all(link.first != link.second for link in found.links)
    )


def _fits(value: Any, hint: Any) -> bool:
    """Whether a value from JSON is of a type: of texts, counts, measures, lists and mappings."""
    kinds = typing.get_args(hint)
    match typing.get_origin(hint) or hint:
        case builtins.list:
            return isinstance(value, list) and all(_fits(v, kind) for v in value for kind in kinds)
        case builtins.dict:
            return isinstance(value, dict) and all(_fits(v, kinds[1]) for v in value.values())
        case types.UnionType | typing.Union:
            return any(_fits(value, kind) for kind in kinds)
        case builtins.float:
            return type(value) in (int, float) and 0 <= value < math.inf
        case builtins.int:
            return type(value) is int and value >= 0
        case kind:
            return type(value) is kind
