"""Reads and checks a `transforms.json`; see `transforms` for its content."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from framework.compute.elementary import product, sinc_cosine
from framework.errors import UserError, require
from framework.files.documents import read_json
from framework.files.limits import PHOTO_PIXELS, TEXT_BYTES
from framework.files.opened import is_file
from framework.scenes.cameras import check_size, checked_lens, checked_pose
from framework.scenes.conventions import decoded_as
from framework.scenes.decoding import image_size
from framework.scenes.formats import find_photo
from framework.scenes.lens import Distortion, Lens
from framework.scenes.listed import find_photos
from framework.scenes.masks import find_masks
from framework.scenes.photo import Photo

FULL = "FULL_OPENCV"
MODELS = ("PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", FULL)
LENS = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")  # in the order of Distortion's fields
UNSUPPORTED = ("s1", "s2", "s3", "s4")
NUMBERS = (
    *("fl_x", "fl_y", "cx", "cy", "w", "h", "camera_angle_x", "camera_angle_y"),
    *(*LENS, *UNSUPPORTED),
)
# what nerfstudio applied to a COLMAP model before it wrote applied_transform
OLD_NERFSTUDIO = [[0, 1, 0, 0], [1, 0, 0, 0], [0, 0, -1, 0]]
OPENGL_TO_OPENCV = np.array([1.0, -1.0, -1.0])  # the signs of a camera's axes
LAYOUT_POSES = "opengl_c2w"  # of the layout


@dataclass(frozen=True)
class Frame:
    """A frame of the file.

    Attributes:
        name: the file path as written, with suffix.
        file: the photo; the transforms.json where only cameras are read.
        viewmat: [4, 4] OpenCV world-to-camera.
        values: its intrinsics.
        where: starts a message about it.
        entry: the frame's object in the file.
        mask: a picture, black where the photo does not count.
    """

    name: str
    file: Path
    viewmat: NDArray[np.float64]
    values: Mapping[str, float]
    where: str
    entry: Mapping[str, Any]
    mask: Path | None = None

    def photo(self) -> Photo:
        """The photo, with a lens of its size unless the file gives one."""
        lens = self.lens(*image_size(self.file, PHOTO_PIXELS))
        return Photo(self.file, self.name, lens, self.viewmat, self.mask, self.sized)

    @property
    def sized(self) -> bool:
        """Whether the file gives the size of the photos that the intrinsics belong to."""
        return {"w", "h"} <= self.values.keys()

    def lens(self, width: int, height: int) -> Lens:
        """The intrinsics, for a photo of width x height if the file gives no size.

        fl_x, else from camera_angle_x = 2 atan(w / (2 fl_x)); fl_y likewise, else fl_x. The
        principal point is the middle unless given.
        """
        v = self.values
        w, h = v.get("w", width), v.get("h", height)
        fx = self._focal("fl_x", "camera_angle_x", w)
        if fx is None:
            raise UserError(f"{self.where}: expected fl_x or camera_angle_x, got neither; add one")
        fy = self._focal("fl_y", "camera_angle_y", h)
        distortion = Distortion(*(v.get(k, 0.0) for k in LENS))
        cx, cy = v.get("cx", w / 2), v.get("cy", h / 2)
        lens = Lens(round(w), round(h), fx, fx if fy is None else fy, cx, cy, distortion)
        checked_lens(lens, self.where)
        if not self.sized:
            check_size(lens, self.where)
        return lens

    def _focal(self, key: str, angle: str, size: float) -> float | None:
        """The focal length in pixels under `key`, else from the `angle` of view over `size`."""
        if key in self.values or angle not in self.values:
            return self.values.get(key)
        view = self.values[angle]
        require(
            0 < view < math.pi,
            f"{self.where}: expected {angle} in (0, pi) radians, got {view}; correct it",
        )
        sinc, cosine = sinc_cosine((view / 2) ** 2)
        return size / view * cosine / sinc


def read_frames(path: Path, poses: str = LAYOUT_POSES) -> list[Frame]:
    """Read the frames in the file's order; photos may be missing.

    Args:
        path: the file.
        poses: how it writes poses, see `conventions.CONVENTIONS`.

    Raises:
        UserError: a value is invalid.
    """
    frames = []
    for frame in read_cameras(path):
        name, file = _relative(path.parent, frame.name)
        mask = frame.mask and find_photo(path.parent, str(frame.mask))
        viewmat = decoded_as(frame.viewmat, LAYOUT_POSES, poses)
        frames.append(replace(frame, name=name, file=file, mask=mask, viewmat=viewmat))
    _check_once(path, [frame.name for frame in frames])
    return frames


def with_photos(path: Path, frames: Sequence[Frame]) -> dict[int, Frame]:
    """Leave out frames without a photo, and add masks of `masks/`; logs warnings about both.

    Returns:
        The frames with photos by their index.

    Raises:
        UserError: no photo exists.
    """
    files = find_photos(path.parent, [frame.name for frame in frames], str(path))
    kept = {i: replace(frames[i], file=file) for i, file in files.items()}
    bare = {i: frame.name for i, frame in kept.items() if frame.mask is None}
    photos = next((name.split("/")[0] for name in bare.values() if name.startswith("images")), "")
    names = [name.removeprefix(f"{photos}/") for name in bare.values()]
    for i, mask in zip(bare, find_masks(path.parent, photos, names), strict=True):
        kept[i] = replace(kept[i], mask=mask)
    return kept


def read_extras(path: Path) -> tuple[Path | None, tuple[NDArray[np.float64], ...]]:
    """Read nerfstudio's fields about points.

    Returns:
        The file of `ply_file_path`, and [4, 4] transforms that may lead from the world of the
        COLMAP model to that of the poses.

    Raises:
        UserError: for invalid ones.
    """
    data = _read_json(path)
    ply = _text(data, "ply_file_path", str(path))
    matrix = _matrix(data.get("applied_transform", OLD_NERFSTUDIO))
    require(
        matrix.shape == (4, 4) and bool(np.isfinite(matrix).all()),
        f"{path}: expected applied_transform to be a 3x4 matrix, got another; correct or remove it",
    )
    return None if ply is None else find_photo(path.parent, ply), (np.eye(4), matrix)


def read_cameras(path: Path) -> list[Frame]:
    """Read the frames in the file's order, without looking for photos; names as written.

    Raises:
        UserError: for invalid values.
    """
    data = _read_json(path)
    entries = data.get("frames")
    if not isinstance(entries, list) or not entries:
        raise UserError(f"{path}: expected a list 'frames' of photos, got none; is it complete?")
    common = _values(data, str(path))
    frames = []
    for i, entry in enumerate(entries):
        require(
            isinstance(entry, dict) and isinstance(entry.get("file_path"), str),
            f"{path}: frame {i}: expected an object with 'file_path', got none; add it",
        )
        where = f"{path}: frame {i} ({entry['file_path'][:200]})"
        viewmat = _viewmat(entry.get("transform_matrix"), where)
        values = _merged(common, _values(entry, where))
        mask = _text(entry, "mask_path", where)
        file = None if mask is None else Path(mask)
        frames.append(Frame(entry["file_path"], path, viewmat, values, where, entry, file))
    _check_once(path, [frame.name for frame in frames])  # before files are looked up
    return frames


def read_roles(path: Path) -> tuple[set[str], set[str]]:
    """The names of the file's training and test photos, with or without suffix; empty sets if it
    has none.

    Raises:
        UserError: for anything but lists of names.
    """
    data = _read_json(path)
    roles = []
    for key in ("train_filenames", "test_filenames", "val_filenames"):
        names = data.get(key) or []
        require(
            isinstance(names, list) and all(isinstance(name, str) for name in names),
            f"{path}: expected {key} to be a list of names, got something else; correct it",
        )
        roles.append({_relative(path.parent, name)[0] for name in names})
    train, test, val = roles
    return train, test or val


def _merged(common: Mapping[str, float], frame: Mapping[str, float]) -> dict[str, float]:
    """Intrinsics of a frame. Its own focal length or angle of view along x replaces the common ones
    of both axes, its own along y the common ones of y."""
    across, up = ("fl_x", "camera_angle_x"), ("fl_y", "camera_angle_y")
    replaced: set[str] = set()
    if frame.keys() & {*across}:
        replaced |= {*across, *up}
    if frame.keys() & {*up}:
        replaced |= {*up}
    return {**{key: value for key, value in common.items() if key not in replaced}, **frame}


def _text(entry: Mapping[str, Any], key: str, where: str) -> str | None:
    value = entry.get(key)
    require(
        value is None or (isinstance(value, str) and value != ""),
        f"{where}: expected {key} to be a file's name, got {value!r}; correct or remove it",
    )
    return value


def _check_once(path: Path, names: list[str]) -> None:
    name, times = Counter(names).most_common(1)[0]
    require(
        times == 1,
        f"{path}: expected each photo once, got {name[:200]} more than once; remove the others",
    )


def _read_json(path: Path) -> dict[str, Any]:
    if not is_file(path):
        parted = path.with_name(f"{path.stem}_train{path.suffix}")  # NeRF's rendered objects
        other = f", but {parted.name}; take scene=blender" if is_file(parted) else None
        raise UserError(
            f"{path}: expected camera poses, found no file{other or '; is scene.path right?'}"
        )
    data = read_json(path, TEXT_BYTES)
    require(isinstance(data, dict), f"{path}: expected a JSON object, got something else; fix it")
    result: dict[str, Any] = data
    return result


def _values(entry: Mapping[str, Any], where: str) -> dict[str, float]:
    """The intrinsics in an object. Raises UserError for lenses that are not supported."""
    model = entry.get("camera_model", MODELS[0])
    require(
        model in MODELS and not entry.get("is_fisheye", False),
        f"{where}: expected camera_model among {', '.join(MODELS)}, got"
        f" {'a fisheye' if entry.get('is_fisheye') else model}; undistort the photos first",
    )
    values = {}
    for key in NUMBERS:
        if key not in entry:
            continue
        value = entry[key]
        require(
            isinstance(value, int | float) and not isinstance(value, bool),
            f"{where}: expected {key} to be a number, got {value}; correct it",
        )
        values[key] = float(value)
    rational = () if model == FULL else ("k4", "k5", "k6")  # nerfstudio's k4 is another term
    odd = [key for key in (*rational, *UNSUPPORTED) if values.get(key, 0.0) != 0.0]
    require(
        not odd,
        f"{where}: expected the lens terms k1, k2, k3, p1, p2 only, got {', '.join(odd)};"
        f" undistort the photos first, or set camera_model to {FULL} if k4, k5, k6 are OpenCV's",
    )
    return values


def _relative(folder: Path, file_path: str) -> tuple[str, Path]:
    """The path of a photo from the folder, as written if it does not exist; and the photo."""
    file = find_photo(folder, file_path)
    exists = is_file(file)
    return file.relative_to(folder).as_posix() if exists else file_path.removeprefix("./"), file


def _matrix(value: Any) -> NDArray[np.float64]:
    """[4, 4] of a 3 x 4 or 4 x 4 matrix; an array of another shape for anything else."""
    try:
        matrix = np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        return np.zeros(0)
    return np.vstack([matrix[:3], np.eye(4)[3]]) if matrix.shape in ((3, 4), (4, 4)) else matrix


def _viewmat(value: Any, where: str) -> NDArray[np.float64]:
    """[4, 4] OpenCV world-to-camera of an OpenGL camera-to-world, 3 x 4 or 4 x 4."""
    pose = _matrix(value)
    require(
        pose.shape == (4, 4),
        f"{where}: expected a transform_matrix of 4x4 numbers, got"
        f" {'none' if value is None else f'shape {pose.shape}'}; correct it",
    )
    viewmat = np.eye(4)
    viewmat[:3, :3] = (pose[:3, :3] * OPENGL_TO_OPENCV).T
    with np.errstate(over="ignore", invalid="ignore"):  # refused by checked_pose
        viewmat[:3, 3] = -product(viewmat[:3, :3], pose[:3, 3])
    return checked_pose(viewmat, f"{where}: transform_matrix")
