"""Calls Depth Anything 3 (Lin et al. 2025, package `depth_anything_3`) on the training views.

It takes images [h, w, 3] uint8 RGB of one size, extrinsics [N, 4, 4] world-to-camera with OpenCV
axes, and intrinsics [N, 3, 3] in pixels of those images. It returns z depth [N, h', w'] of another
size, in the unit of the extrinsics, and a confidence >= 1. It treats camera distances below 0.1 as
0.1, so the poses are centred and scaled to a median distance of 1 from the centre.
"""

import functools
import hashlib
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from framework.depth.align import align, fit_scale
from framework.depth.consistency import confirmed
from framework.depth.matching.sweep import sweep_views
from framework.depth.options import DEPTH_ANYTHING_3, DepthAnything3Options, PlaneSweepOptions
from framework.depth.read import resample
from framework.errors import UserError, require
from framework.files.whole import file_sha256
from framework.metrics.evaluate import quantise
from framework.types import DepthMap, TrainingSet

Floats = NDArray[np.float64]
WHERE = "depth=depth_anything_3"
FILES = ("config.json", "model.safetensors")
LEAST_CONFIDENCE = 0.05  # of a pixel that other views confirm
FEWEST_PIXELS = 100  # of the plane sweep that set a view's scale
POSE_TOLERANCE = 1e-3  # in units of the poses: the package kept the given ones


def predict_views(training: TrainingSet, options: DepthAnything3Options) -> tuple[DepthMap, ...]:
    """See `providers.DepthAnything3.measure`."""
    predicted, confidence = predict(training, options)
    size = (training.views[0].camera.width, training.views[0].camera.height)
    sized = [resample(depth, *size) for depth in predicted]
    depths = [d.astype(np.float32) for d in _in_scene_units(training, sized, options)]
    scores = [resample(c, *size) * (d > 0) for c, d in zip(confidence, depths, strict=True)]
    if options.tolerance > 0 and len(depths) > 1:
        agreed = confirmed(training, depths, options.tolerance)
        scores = [score * agrees for score, agrees in zip(scores, agreed, strict=True)]
    each = zip(depths, scores, strict=True)
    return tuple(DepthMap(*(torch.from_numpy(a.astype(np.float32)) for a in pair)) for pair in each)


def predict(training: TrainingSet, options: DepthAnything3Options) -> tuple[Floats, Floats]:
    """Call the network on the training views.

    Returns:
        depth [N, h, w] float64 in scene units, 0 = unknown (sky), and confidence in (0, 1].
    """
    images = [quantise(view.image) for view in training.views]
    sizes = sorted({image.shape[:2] for image in images})
    require(
        len(sizes) == 1,  # it would crop them all to the smallest
        f"{WHERE}: expected training images of one size, got"
        f" {', '.join(f'{w}x{h}' for h, w in sizes)}; resize them or use depth=plane_sweep",
    )
    poses, unit = normalised_poses(training)
    K = np.stack([view.camera.K.numpy() for view in training.views]).astype(np.float32)
    network = load_network(weights_folder(options), options.device)
    advice = (  # two views, for one, it cannot align
        "the package needs three or more cameras that are not in line, and enough memory: choose"
        " other views or lower depth.process_res"
    )
    with _explained(f"the network to output for {len(images)} views", advice):
        output = network.inference(
            images, extrinsics=poses, intrinsics=K, process_res=options.process_res
        )
    if options.align == "none":
        _require_given_poses(output, poses)
    return _prediction(output, len(images), unit)


def normalised_poses(training: TrainingSet) -> tuple[NDArray[np.float32], float]:
    """Centre and scale the camera poses.

    Returns:
        [N, 4, 4] world-to-camera, with the origin at the cameras' centre and their median distance
        from it as unit; and that unit in scene units (1 for a single camera).
    """
    poses = np.stack([view.camera.viewmat.numpy() for view in training.views])
    centers = np.stack([view.camera.center.numpy() for view in training.views])
    middle = centers.mean(0)
    unit = float(np.median(np.linalg.norm(centers - middle, axis=1))) or 1.0
    moved = poses.copy()
    moved[:, :3, 3] = (poses[:, :3, 3] + poses[:, :3, :3] @ middle) / unit
    return moved.astype(np.float32), unit


def _require_given_poses(output: Any, poses: NDArray[np.float32]) -> None:
    """The package brings depth to the unit of the given poses, but keeps its own poses and units
    where that fails, with a mere warning."""
    extrinsics = None if output.extrinsics is None else np.asarray(output.extrinsics)[:, :3]
    require(
        extrinsics is not None and bool(np.abs(extrinsics - poses[:, :3]).max() < POSE_TOLERANCE),
        f"{WHERE}: expected depth in the unit of the camera poses, got the network's own units (it"
        " could not align the poses); use depth.align=points or depth.align=plane_sweep",
    )


def _prediction(output: Any, n: int, unit: float) -> tuple[Floats, Floats]:
    depth = np.asarray(output.depth, np.float64)
    require(
        depth.ndim == 3 and len(depth) == n,
        f"{WHERE}: expected depth [{n}, h, w] from the network, got shape {depth.shape}; install"
        f" the package from {DEPTH_ANYTHING_3}",
    )
    valid = np.isfinite(depth) & (depth > 0)
    if output.sky is not None:
        valid &= ~np.asarray(output.sky, bool)
    confidence = np.ones_like(depth)
    if output.conf is not None:
        raw = np.maximum(np.asarray(output.conf, np.float64), 1.0)
        confidence = np.maximum(1.0 - 1.0 / raw, LEAST_CONFIDENCE)
    return unit * np.where(valid, depth, 0.0), confidence


def _in_scene_units(
    training: TrainingSet, depths: list[Floats], options: DepthAnything3Options
) -> list[Floats]:
    """The depths [H, W] times one factor per view."""
    if options.align == "none":
        return depths
    if options.align == "points":
        way_out = "use depth.align=plane_sweep"
        return [
            align(training, i, depth, False, "scale", WHERE, way_out)
            for i, depth in enumerate(depths)
        ]
    swept = sweep_views(training, PlaneSweepOptions())
    return [_like_sweep(training, i, depth, swept[i]) for i, depth in enumerate(depths)]


def _like_sweep(training: TrainingSet, index: int, depth: Floats, swept: DepthMap) -> Floats:
    """`depth` [H, W] times the median ratio of the confident plane sweep to it."""
    both = (depth > 0) & (swept.confidence.numpy() > 0)
    require(
        int(both.sum()) >= FEWEST_PIXELS,
        f"{WHERE}: align=plane_sweep needs {FEWEST_PIXELS} pixels with consistent depth in view"
        f" '{training.views[index].name}', got {int(both.sum())}; use depth.align=points",
    )
    return depth * fit_scale(depth[both], swept.depth.numpy().astype(np.float64)[both])


def weights_folder(options: DepthAnything3Options) -> Path:
    """The folder of the weights; those on the hub are downloaded into its cache if not there."""
    folder = Path(options.weights).expanduser()
    if not folder.is_dir():
        _api()
        expected = f"the weights '{options.weights}' in a local folder or on the Hugging Face hub"
        with _explained(expected, f"set depth.weights to the folder with {' and '.join(FILES)}"):
            from huggingface_hub import snapshot_download

            found = snapshot_download(
                options.weights, revision=options.revision, allow_patterns=list(FILES)
            )
            folder = Path(found)
    missing = [name for name in FILES if not (folder / name).is_file()]
    require(
        not missing,
        f"{WHERE}: expected {' and '.join(FILES)} in {folder}, got no {' and no '.join(missing)};"
        " set depth.weights to a folder as the hub has it",
    )
    return folder


def weights_sha256(options: DepthAnything3Options) -> str:
    """See `providers.DepthAnything3.fingerprint`."""
    _api()
    try:
        package = version("depth_anything_3")
    except PackageNotFoundError:
        package = "not installed as a distribution"
    folder = weights_folder(options)
    digest = hashlib.sha256(f"{package}\n".encode())
    for name in FILES:
        file = folder / name
        digest.update(_file_sha256(file, file.stat().st_mtime_ns, file.stat().st_size).encode())
    return digest.hexdigest()


@functools.lru_cache(maxsize=8)
def _file_sha256(file: Path, modified_ns: int, size: int) -> str:
    """SHA-256 of a large file, once per process while it does not change."""
    return file_sha256(file)


@contextmanager
def _explained(expected: str, advice: str) -> Iterator[None]:
    """Raise UserError for what the package or the hub raises. They document no exceptions, and a
    failed import, download or inference is nothing that the caller could handle."""
    try:
        yield
    except Exception as problem:
        reason = (str(problem).splitlines() or [""])[0]
        got = f"{type(problem).__name__} ({reason})"
        raise UserError(f"{WHERE}: expected {expected}, got {got}; {advice}") from problem


def _api() -> Any:
    """The package's module. UserError naming what to install where it is missing."""
    with _explained("the package depth_anything_3", f"pip install {DEPTH_ANYTHING_3}"):
        from depth_anything_3 import api

        return api


@functools.lru_cache(maxsize=1)
def load_network(folder: Path, device: str) -> Any:
    """The network in evaluation mode on `device`; kept for the next call of the process."""
    api = _api()
    expected = f"a network that loads from {folder} on device '{device}'"
    with _explained(expected, "check depth.weights and depth.device"):
        network = api.DepthAnything3.from_pretrained(str(folder))
        return network.to(torch.device(device)).eval()
