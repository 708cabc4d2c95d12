"""Calls Depth Anything 3 (Lin et al. 2025, package `depth_anything_3`) on the training views.

It takes images [h, w, 3] uint8 RGB of one size, extrinsics [N, 4, 4] world-to-camera with OpenCV
axes, and intrinsics [N, 3, 3] in pixels of those images. It returns z depth [N, h', w'] of another
size, in the unit of the extrinsics, and a confidence >= 1. It treats camera distances below 0.1 as
0.1, so the poses are centred and scaled to a median distance of 1 from the centre.
"""

import functools
import hashlib
from dataclasses import dataclass
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
from framework.types import DepthMap, TrainingSet

WHERE = "depth=depth_anything_3"
FILES = ("config.json", "model.safetensors")
LEAST_CONFIDENCE = 0.05  # of a pixel that other views confirm
FEWEST_PIXELS = 100  # of the plane sweep that set a view's scale
POSE_TOLERANCE = 1e-3  # in units of the poses: the package kept the given ones


@dataclass(frozen=True)
class Prediction:
    """depth [N, h, w] float64, 0 = unknown (sky), in the unit of the poses; confidence [N, h, w] in
    (0, 1]."""

    depth: NDArray[np.float64]
    confidence: NDArray[np.float64]


def predict_views(training: TrainingSet, options: DepthAnything3Options) -> tuple[DepthMap, ...]:
    """See `providers.DepthAnything3.measure`."""
    predicted = predict(training, options)
    size = (training.views[0].camera.width, training.views[0].camera.height)
    sized = [resample(depth, *size) for depth in predicted.depth]
    depths = [d.astype(np.float32) for d in _in_scene_units(training, sized, options)]
    scores = [
        resample(c, *size) * (d > 0) for c, d in zip(predicted.confidence, depths, strict=True)
    ]
    if options.tolerance > 0 and len(depths) > 1:
        agreed = confirmed(training, depths, options.tolerance)
        scores = [score * agrees for score, agrees in zip(scores, agreed, strict=True)]
    each = zip(depths, scores, strict=True)
    return tuple(DepthMap(*(torch.from_numpy(a.astype(np.float32)) for a in pair)) for pair in each)


def predict(training: TrainingSet, options: DepthAnything3Options) -> Prediction:
    """Call the network on the training views; its depth is in units of the poses."""
    images = [_pixels(view.image) for view in training.views]
    sizes = sorted({image.shape[:2] for image in images})
    require(
        len(sizes) == 1,  # it would crop them all to the smallest
        f"{WHERE}: expected training images of one size, got"
        f" {', '.join(f'{w}x{h}' for h, w in sizes)}; resize them or use depth=plane_sweep",
    )
    poses, unit = normalised_poses(training)
    K = np.stack([view.camera.K.numpy() for view in training.views]).astype(np.float32)
    network = load_network(weights_folder(options), options.device)
    try:
        output = network.inference(
            images, extrinsics=poses, intrinsics=K, process_res=options.process_res
        )
    except Exception as problem:  # whatever the package raises; two views, for one, it cannot align
        reason = (str(problem).splitlines() or [""])[0]
        raise UserError(
            f"{WHERE}: expected the network to output for {len(images)} views, got"
            f" {type(problem).__name__} ({reason}); the package needs three or more cameras that"
            " are not in line, and enough memory: choose other views or lower depth.process_res"
        ) from problem
    if options.align == "none":
        _require_given_poses(output, poses)
    return _prediction(output, len(images), unit)


def _pixels(image: torch.Tensor) -> NDArray[np.uint8]:
    """[3, H, W] in [0, 1] to [H, W, 3] uint8."""
    values = np.rint(255 * np.clip(image.numpy(), 0, 1)).astype(np.uint8)
    return np.ascontiguousarray(values.transpose(1, 2, 0))


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


def _prediction(output: Any, n: int, unit: float) -> Prediction:
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
    return Prediction(np.where(valid, unit * np.where(valid, depth, 0.0), 0.0), confidence)


def _in_scene_units(
    training: TrainingSet, depths: list[NDArray[np.float64]], options: DepthAnything3Options
) -> list[NDArray[np.float64]]:
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


def _like_sweep(
    training: TrainingSet, index: int, depth: NDArray[np.float64], swept: DepthMap
) -> NDArray[np.float64]:
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
        folder = _download(options)
    missing = [name for name in FILES if not (folder / name).is_file()]
    require(
        not missing,
        f"{WHERE}: expected {' and '.join(FILES)} in {folder}, got no {' and no '.join(missing)};"
        " set depth.weights to a folder as the hub has it",
    )
    return folder


def _download(options: DepthAnything3Options) -> Path:
    try:
        from huggingface_hub import snapshot_download

        return Path(
            snapshot_download(
                options.weights, revision=options.revision, allow_patterns=list(FILES)
            )
        )
    except Exception as problem:  # not there, no network, not allowed: the hub has many
        reason = (str(problem).splitlines() or [""])[0]
        raise UserError(
            f"{WHERE}: expected the weights '{options.weights}' in a local folder or on the Hugging"
            f" Face hub, got {type(problem).__name__} ({reason}); set depth.weights to the folder"
            f" with {' and '.join(FILES)}"
        ) from problem


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


def _api() -> Any:
    """The package's module. UserError naming what to install where it is missing."""
    try:
        from depth_anything_3 import api
    except ImportError as problem:
        raise UserError(
            f"{WHERE}: expected the package depth_anything_3, got {problem}; install it with: pip"
            f" install {DEPTH_ANYTHING_3}"
        ) from problem
    return api


@functools.lru_cache(maxsize=1)
def load_network(folder: Path, device: str) -> Any:
    """The network in evaluation mode on `device`; kept for the next call of the process."""
    api = _api()
    try:
        network = api.DepthAnything3.from_pretrained(str(folder))
        return network.to(torch.device(device)).eval()
    except Exception as problem:  # a broken file, an unknown device, too little memory
        reason = (str(problem).splitlines() or [""])[0]
        raise UserError(
            f"{WHERE}: expected a network that loads from {folder} on device '{device}', got"
            f" {type(problem).__name__} ({reason}); check depth.weights and depth.device"
        ) from problem
