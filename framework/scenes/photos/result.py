"""The result of a search for poses, kept as `poses.json` next to the model."""

import dataclasses
import json
from dataclasses import dataclass, field
from pathlib import Path

from framework.files.documents import read_json
from framework.files.limits import TEXT_BYTES
from framework.files.opened import reading
from framework.files.whole import write_whole

FILE = "poses.json"


@dataclass(frozen=True)
class Link:
    """Two photos whose matches agree with one motion of the camera.

    Attributes:
        shift: median distance between the two places of a feature, over the photos' longer side.
        flat: a homography explains all matches, so they show no depth: the camera has only turned,
            or the scene is flat.
    """

    first: str
    second: str
    matches: int
    shift: float
    flat: bool = False


@dataclass(frozen=True)
class Overruled:
    """EXIF's focal length and the estimate that replaced it, in pixels of the prepared photo.

    The errors are mean reprojection errors in pixels; exif_error_px is None if EXIF's focal length
    placed fewer photos.
    """

    exif_px: float
    found_px: float
    exif_error_px: float | None
    found_error_px: float


@dataclass(frozen=True)
class Try:
    """One step of the search: the photos it placed, and CPU seconds of its stages."""

    step: str
    placed: int
    features_cpu_s: float
    matching_cpu_s: float
    mapping_cpu_s: float


@dataclass(frozen=True)
class Poses:
    """The poses that an attempt finds, without the model.

    Attributes:
        placed: photo with a pose -> number of 3D points that it sees.
        groups: photos with poses relative to each other, but not to the scene.
        features: photo -> number of its features.
        held: the focal length was fixed, as the photos do not determine it.
        overruled: EXIF's focal length, if the photos contradict it.
    """

    placed: dict[str, int] = field(default_factory=dict)
    groups: list[list[str]] = field(default_factory=list)
    features: dict[str, int] = field(default_factory=dict)
    links: list[Link] = field(default_factory=list)
    held: bool = False
    overruled: Overruled | None = None


@dataclass(frozen=True, kw_only=True)
class Result(Poses):
    """The result of a search.

    Attributes:
        photos: all photos, in order.
        reduced: some photos were larger than `scene.side`.
        copies: see `Source`.
    """

    photos: list[str]
    tries: list[Try]
    seconds: float
    video: bool = False
    reduced: bool = False
    copies: dict[str, str] = field(default_factory=dict)


def write_result(folder: Path, result: Result) -> None:
    """Write `poses.json` into `folder`."""
    write_whole(folder / FILE, json.dumps(dataclasses.asdict(result), indent=1))


def read_result(folder: Path) -> Result:
    """Read `poses.json` of `folder`.

    Raises:
        UserError: for a damaged one.
    """
    path = folder / FILE
    expected = "the kept result of a search for poses"
    with reading(path, expected, f"remove the folder {folder.name}"):
        values = read_json(path, TEXT_BYTES)
        values["links"] = [Link(**link) for link in values["links"]]
        values["tries"] = [Try(**attempt) for attempt in values["tries"]]
        if values.get("overruled") is not None:
            values["overruled"] = Overruled(**values["overruled"])
        result = Result(**values)
        if not result.placed or any("/" in name for name in result.placed):
            raise ValueError("no file names of placed photos")
    return result
