"""The smallest SPZ file of a run that looks like it, found by measuring (`export --compact`).

Gaussians are sorted along the axis on which they spread most, which saves 6 % after gzip on two
scenes (benchmarks/results/exports.md). Then SH bands are left out, the others are rounded, and
coordinates are rounded, in this order. In total, the PSNR of the training photos falls by at most
`LIMIT_DB`. Colours of bands that are left out are averaged over the training cameras and added to
`sh0`.

Opacities, scales, rotations and sh0 have the precision of the format: rounding them further saves 1
or 2 % in trials. Runs do not keep the masks of training photos, so a masked scene is judged by
whole photos.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from framework.errors import require
from framework.exports.formats import finest_fraction, full, spz
from framework.exports.opened import OpenedRun, read_run_cameras
from framework.files.opened import is_file
from framework.files.paths import inside
from framework.metrics.evaluate import psnr
from framework.records.cameras import TRANSFORMS
from framework.records.run_files import RENDERS, file_stems, photo_files
from framework.records.spz_reader import unpacked
from framework.scenes.images import read_image

if TYPE_CHECKING:
    from torch import Tensor

    from framework.types import Camera, Gaussians

LIMIT_DB = 0.05  # of the PSNR of the training photos
MOST_PHOTOS = 12  # for training, spread evenly over all
FEWEST_BITS = 4  # of an SH coefficient, as in Niantic's own writer
LEAST_FRACTION = 4


@dataclass(frozen=True)
class Photo:
    """image: [3, H, W]. mask: [H, W]. exposure: [3], factors of a render for this photo."""

    camera: Camera
    image: Tensor
    mask: Tensor | None
    exposure: Tensor


@dataclass(frozen=True)
class Precision:
    """degree: of the SH bands. bits: of one of their coefficients. fraction: bits behind the point
    of a coordinate."""

    degree: int
    bits: int
    fraction: int


@dataclass(frozen=True)
class Compact:
    """The smallest file: its content, what it holds, and the Gaussians that a reader gets."""

    content: bytes
    precision: Precision
    gaussians: Gaussians


def read_photos(folder: Path) -> tuple[list[Photo], list[Photo]]:
    """The training and the test photos of a run; training photos have no masks.

    Raises:
        UserError: for damaged files.
    """
    import torch

    read = read_run_cameras(folder)
    cameras = {named.name: named for named in read.cameras}

    def photos(names: Sequence[str], files: Sequence[str]) -> Iterator[Photo]:
        for name, file in zip(names, files, strict=True):
            require(
                name in cameras,
                f"{folder / TRANSFORMS}: expected a camera of {name!r:.80}, got none",
            )
            if not is_file(folder / file):
                continue
            camera, image = cameras[name].camera, _pixels(inside(folder, file))
            require(
                image.shape[1:] == (camera.height, camera.width),
                f"{folder / file}: expected {camera.width}x{camera.height} pixels as its camera has"
                f", got {image.shape[2]}x{image.shape[1]}; run again",
            )
            mask = file.replace("_truth.png", "_mask.png")
            masked = mask != file and is_file(folder / mask)
            yield Photo(
                camera,
                image,
                _pixels(inside(folder, mask))[0] if masked else None,
                torch.tensor(cameras[name].exposure),
            )

    shown = [f"{RENDERS}/{stem}_truth.png" for stem in file_stems(read.test)]
    training = photos(read.training, photo_files(read.training))
    return [*training], [*photos(read.test, shown)]


def _pixels(file: Path) -> Tensor:
    """[3, H, W] in [0, 1]."""
    import torch

    return torch.from_numpy(read_image(file).astype(np.float32) / 255).permute(2, 0, 1)


def mean_psnr(run: OpenedRun, gaussians: Gaussians, photos: Sequence[Photo]) -> float:
    """Mean PSNR in dB of renders of `gaussians` with the background of a run."""
    drawn = replace(run, gaussians=gaussians)
    values = []
    for photo in photos:
        render = drawn.render(photo.camera).rgb * photo.exposure[:, None, None]
        values.append(psnr(render.clamp(0, 1), photo.image, photo.mask))
    return float(np.mean([value for value in values if isinstance(value, float)]))


def compact(run: OpenedRun, photos: Sequence[Photo]) -> Compact:
    """Find the smallest SPZ file of a run.

    Args:
        photos: for training; without any, nothing but the order is changed.

    Raises:
        UserError: if SPZ cannot hold the Gaussians.
    """
    gaussians = _sorted(full(run.gaussians))
    finest = Precision(gaussians.sh_degree, 8, finest_fraction(gaussians))

    def written(precision: Precision) -> Compact:
        rounded = _rounded(_fewer_bands(gaussians, precision.degree, run), precision.bits)
        content = spz(rounded, precision.fraction)
        return Compact(content, precision, decoded(content))

    best = written(finest)
    if not photos:
        return best
    photos = photos[:: -(-len(photos) // MOST_PHOTOS)]
    goal = mean_psnr(run, gaussians, photos) - LIMIT_DB
    for name, least in (("degree", 0), ("bits", FEWEST_BITS), ("fraction", LEAST_FRACTION)):
        while (value := getattr(best.precision, name)) > least:
            if name == "bits" and best.precision.degree == 0:
                break
            trial = written(replace(best.precision, **{name: value - 1}))
            if not mean_psnr(run, trial.gaussians, photos) >= goal:
                break
            best = trial
    return best


def decoded(content: bytes) -> Gaussians:
    """The Gaussians of an SPZ file."""
    return unpacked(content, "the written file").gaussians()


def _sorted(gaussians: Gaussians) -> Gaussians:
    widest = int(gaussians.means.std(0, correction=0).argmax())
    return gaussians[gaussians.means[:, widest].argsort(stable=True)]


def _fewer_bands(gaussians: Gaussians, degree: int, run: OpenedRun) -> Gaussians:
    """With SH bands up to `degree`; the mean colour of the others as the cameras of `run` see them
    is added to sh0."""
    import torch

    from framework.kernels.reference import sh_basis

    if degree == gaussians.sh_degree:
        return gaussians
    kept = (degree + 1) ** 2 - 1
    mean = torch.zeros_like(gaussians.sh0[:, 0])
    for named in run.cameras:
        directions = torch.nn.functional.normalize(gaussians.means - named.camera.center.float())
        basis = sh_basis(directions, gaussians.sh_degree)
        lost = torch.einsum("nk,nkc->nc", basis[:, 1 + kept :], gaussians.shN[:, kept:])
        mean += lost / basis[:, :1] / len(run.cameras)
    return gaussians.replace(
        sh0=gaussians.sh0 + mean[:, None], shN=gaussians.shN[:, :kept].contiguous()
    )


def _rounded(gaussians: Gaussians, bits: int) -> Gaussians:
    """With SH bands that take so many of the eight bits of the file."""
    if bits == 8 or gaussians.sh_degree == 0:
        return gaussians
    step = 2.0 ** (8 - bits) / 128
    return gaussians.replace(shN=(gaussians.shN / step).round() * step)
