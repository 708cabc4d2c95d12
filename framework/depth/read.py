"""Reading depth files: .npy, .npz (key `depth`) and 16-bit .png, one per training view."""

import hashlib
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from framework.depth.align import align
from framework.depth.consistency import confirmed
from framework.depth.options import DepthFileOptions
from framework.errors import UserError, require
from framework.files.arrays import read_npy, read_npz
from framework.files.limits import IMAGE_BYTES, IMAGE_PIXELS
from framework.files.opened import is_file, read_bytes
from framework.files.paths import inside
from framework.files.whole import file_sha256
from framework.scenes.decoding import image_size
from framework.types import DepthMap, TrainingSet, View

SUFFIXES = (".npy", ".npz", ".png")
ASPECT_TOLERANCE = 0.02
JUMP = 1.1  # neighbours whose depths differ by more lie on two surfaces: nothing in between exists


def find_file(folder: Path, view: str) -> Path:
    """The depth file of a view; UserError if there is none, more than one, or a link that leads
    out of the folder.

    Looked for under the view's relative path first (`cam1/0001.jpg`: `cam1/0001.npy`), then by its
    file name alone.
    """
    name = Path(view)
    below = not name.is_absolute() and ".." not in name.parts
    matches = _with_suffixes(folder / name) if below else []
    matches = matches or _with_suffixes(folder / name.name)
    if not matches:
        raise UserError(
            f"depth=file: expected '{name.with_suffix('')}' with one of {', '.join(SUFFIXES)} in"
            f" {folder} for view '{view}', got none; name the files by the views"
        )
    if len(matches) > 1:
        raise UserError(
            f"depth=file: expected one file for view '{view}' in {folder}, got"
            f" {', '.join(p.name for p in matches)}; remove all but one"
        )
    return inside(folder, matches[0].relative_to(folder))


def _with_suffixes(image: Path) -> list[Path]:
    """The files named like `image`, with a depth suffix in place of or after the suffix."""
    stems = dict.fromkeys([image.with_suffix("").name, image.name])
    candidates = [image.with_name(f"{stem}{suffix}") for stem in stems for suffix in SUFFIXES]
    return [path for path in candidates if is_file(path)]


def find_files(training: TrainingSet, options: DepthFileOptions) -> list[Path]:
    """The depth files of all training views, in their order; UserError unless they
    are distinct."""
    folder = Path(options.path).expanduser()
    require(
        folder.is_dir(),
        f"depth=file: expected a folder at {folder}, got none; correct depth.path",
    )
    owners: dict[Path, str] = {}
    for view in training.views:
        file = find_file(folder, view.name)
        if file in owners:
            raise UserError(
                f"depth=file: expected a file for each view, got {file} for both"
                f" '{owners[file]}' and '{view.name}'; arrange the files in {folder} like the"
                " views, with subfolders and whole names"
            )
        owners[file] = view.name
    return list(owners)


def files_sha256(training: TrainingSet, options: DepthFileOptions) -> str:
    """See `providers.DepthFile.fingerprint`."""
    digest = hashlib.sha256()
    for file in find_files(training, options):
        # the same bytes mean other values under another suffix
        digest.update(f"{file.suffix} {file_sha256(file)}\n".encode())
    return digest.hexdigest()


def _load_array(file: Path) -> NDArray[np.float64]:
    values = read_npy(file) if file.suffix == ".npy" else read_npz(file, ["depth"])[0]
    require(
        values.size <= IMAGE_PIXELS,
        f"{file}: expected at most {IMAGE_PIXELS:,} pixels, got {values.size:,}; resize the map",
    )
    return values.astype(np.float64)


def _load_png(file: Path, scale: float) -> NDArray[np.float64]:
    image_size(file)  # refuses a small file that would unpack to a huge image
    stored = np.frombuffer(read_bytes(file, IMAGE_BYTES), np.uint8)
    image = cv2.imdecode(stored, cv2.IMREAD_UNCHANGED)
    got = "an unreadable file" if image is None else f"{image.dtype} {image.shape}"
    if image is None or image.dtype != np.uint16 or image.ndim != 2:
        raise UserError(
            f"depth=file: expected a 16-bit grey png in {file}, got {got}; use .npy instead"
        )
    return image.astype(np.float64) / scale


def load_map(file: Path, options: DepthFileOptions) -> NDArray[np.float64]:
    """The values of one file, [h, w] float64, 0 = unknown. UserError on invalid ones."""
    is_png = file.suffix == ".png"
    values = _load_png(file, options.png_scale) if is_png else _load_array(file)
    values = values.reshape(values.shape[-2:]) if values.ndim == 3 and len(values) == 1 else values
    require(
        values.ndim == 2 and values.size > 0,
        f"depth=file: expected one value per pixel [H, W] in {file}, got shape {values.shape};"
        " save a single map per view",
    )
    bad = ~np.isfinite(values) | (values < 0)
    if bad.any() and options.invalid == "error":
        nan, negative = int(np.isnan(values).sum()), int((values < 0).sum())
        raise UserError(
            f"depth=file: expected finite values >= 0 in {file}, got {int(bad.sum())} of"
            f" {bad.size} invalid ({nan} NaN, {int(np.isinf(values).sum())} infinite, {negative}"
            " negative); repair it or set depth.invalid=mask"
        )
    return np.where(bad, 0.0, values)


def resample(values: NDArray[np.float64], width: int, height: int) -> NDArray[np.float64]:
    """`values` [h, w] at the pixel centres of a [height, width] image over the same field.

    Bilinear among four known values of one surface, else the nearest one, so that neither holes nor
    depth edges smear.
    """
    h, w = values.shape
    if (h, w) == (height, width):
        return values
    y = np.clip((np.arange(height) + 0.5) * h / height - 0.5, 0, h - 1)[:, None]
    x = np.clip((np.arange(width) + 0.5) * w / width - 0.5, 0, w - 1)[None, :]
    j, i = np.floor(y).astype(np.int64), np.floor(x).astype(np.int64)
    b, r = np.minimum(j + 1, h - 1), np.minimum(i + 1, w - 1)
    corners = np.stack([values[j, i], values[j, r], values[b, i], values[b, r]])
    dy, dx = y - j, x - i
    weights = np.stack([(1 - dy) * (1 - dx), (1 - dy) * dx, dy * (1 - dx), dy * dx])
    nearest = np.take_along_axis(corners, weights.argmax(0)[None], 0)[0]
    low = corners.min(0)
    smooth = (low > 0) & (corners.max(0) <= JUMP * low)
    return np.where(smooth, (weights * corners).sum(0), nearest)


def straightened(values: NDArray[np.float64], view: View) -> NDArray[np.float64]:
    """Undistort the map [H, W] of a stored photo like its view: the nearest value, 0 outside."""
    from framework.scenes.lens import Distortion, distorted_pixels

    height, width = values.shape
    u, v, single = distorted_pixels(height, width, view.camera.K.numpy(), Distortion(*view.lens))
    i, j = np.floor(u).astype(np.int64), np.floor(v).astype(np.int64)
    there = single & (i >= 0) & (i < width) & (j >= 0) & (j < height)
    return np.where(there, values[j.clip(0, height - 1), i.clip(0, width - 1)], 0.0)


def _as_cut(values: NDArray[np.float64], width: int, height: int) -> NDArray[np.float64]:
    """Cut off the last rows and columns that were lost when the photo was reduced by an integer
    factor to width x height."""
    h, w = values.shape
    factor = round(min(w / width, h / height))
    if 0 <= w - factor * width < factor and 0 <= h - factor * height < factor:
        return values[: factor * height, : factor * width]
    return values


def read_view(
    training: TrainingSet, index: int, file: Path, options: DepthFileOptions
) -> NDArray[np.float32]:
    """Aligned depth [H, W] float32 of one training view from its `file`, 0 = unknown."""
    view = training.views[index]
    width, height = view.camera.width, view.camera.height
    values = load_map(file, options)
    h, w = values.shape
    require(
        abs(w / h * height / width - 1) <= ASPECT_TOLERANCE or (h, w) == (height, width),
        f"depth=file: expected the aspect ratio of the {width}x{height} image in {file}, got"
        f" {w}x{h}; crop the depth map like the image",
    )
    sized = resample(_as_cut(values, width, height), width, height)
    if view.lens and not options.straight:
        sized = straightened(sized, view)
    return align(training, index, sized, options.kind == "inverse_depth", options.align).astype(
        np.float32
    )


def read_views(training: TrainingSet, options: DepthFileOptions) -> tuple[DepthMap, ...]:
    """See `providers.DepthFile.measure`."""
    files = find_files(training, options)
    depths = [read_view(training, i, file, options) for i, file in enumerate(files)]
    masks = [depth > 0 for depth in depths]
    if options.tolerance > 0:
        agreed = confirmed(training, depths, options.tolerance)
        masks = [valid & agrees for valid, agrees in zip(masks, agreed, strict=True)]
    return tuple(
        DepthMap(torch.from_numpy(depth), torch.from_numpy(valid.astype(np.float32)))
        for depth, valid in zip(depths, masks, strict=True)
    )
