"""IterMVS on all views of a training set."""

import logging
from collections.abc import Sequence
from functools import lru_cache, partial

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray

from framework.compute.parallel import run_tasks
from framework.depth.consistency import confirmed, depth_map
from framework.depth.itermvs.network import MULTIPLE, IterMvs, Posed
from framework.depth.itermvs.weights import load
from framework.depth.matching.neighbours import choose_neighbours, depth_bounds
from framework.depth.matching.sweep import sweep_views
from framework.depth.options import IterMvsOptions, PlaneSweepOptions
from framework.depth.read import resample
from framework.errors import require
from framework.types import DepthMap, TrainingSet, View

log = logging.getLogger(__name__)

# confirmed network depth of this confidence is right (within 1 %) more often than the plane sweep
# there on fern, scan 24 and fox (benchmarks/results/learned_depth.md)
SURE_CONFIDENCE, SURE_TOLERANCE = 0.3, 0.01
LEAST_SIDE = 448  # pixels; of the longer side of what the network sees
Estimate = tuple[NDArray[np.float32], NDArray[np.float32]]  # depth and confidence, both [H, W]


def measure_views(training: TrainingSet, options: IterMvsOptions) -> tuple[DepthMap, ...]:
    """See `framework.depth.providers.IterMvsDepth.measure`."""
    estimates = estimate_views(training, options)
    return _checked(training, estimates, options.least_confidence, options.tolerance)


def fused_views(training: TrainingSet, options: IterMvsOptions) -> tuple[DepthMap, ...]:
    """See `framework.depth.providers.FusedDepth.measure`."""
    estimates = estimate_views(training, options)
    sources = (
        _checked(training, estimates, SURE_CONFIDENCE, SURE_TOLERANCE),
        sweep_views(training, PlaneSweepOptions()),
        _checked(training, estimates, options.least_confidence, options.tolerance),
    )
    return tuple(fused(*maps) for maps in zip(*sources, strict=True))


def fused(sure: DepthMap, swept: DepthMap, learned: DepthMap) -> DepthMap:
    """Take each pixel from the first map that is confident; depth without any is the sweep's."""
    depth, confidence = swept.depth, swept.confidence
    missing, certain = confidence == 0, sure.confidence > 0
    filled = missing & (learned.confidence > 0)
    for chosen, source in ((filled, learned), (certain, sure)):
        depth = torch.where(chosen, source.depth, depth)
        confidence = torch.where(chosen, source.confidence, confidence)
    return DepthMap(depth, confidence)


def _checked(
    training: TrainingSet, estimates: Sequence[Estimate], least: float, tolerance: float
) -> tuple[DepthMap, ...]:
    """Keep the confidence of depth that is at least that confident and that another view confirms,
    to the relative `tolerance`; 0 elsewhere."""
    agreed = confirmed(training, [depth for depth, _ in estimates], tolerance)
    return tuple(
        depth_map(view, depth, np.where((confidence >= least) & agrees, confidence, 0))
        for view, (depth, confidence), agrees in zip(training.views, estimates, agreed, strict=True)
    )


def estimate_views(training: TrainingSet, options: IterMvsOptions) -> list[Estimate]:
    """Depth and the network's confidence of every view, unchecked; zeros without neighbours."""
    views = training.views
    require(
        len(views) >= 2,
        f"depth=itermvs: expected two or more overlapping training views, got {len(views)} in scene"
        f" '{training.scene}'; use more views, depth=file or depth=ground_truth",
    )
    network = _network(options.weights)
    posed = run_tasks([partial(_posed, network, view) for view in views])
    bounds = [depth_bounds(training, i) for i in range(len(views))]
    sources = [
        choose_neighbours(training, i, options.neighbours, bounds[i]) for i in range(len(views))
    ]
    for view, chosen in zip(views, sources, strict=True):
        if not chosen:
            log.warning("IterMVS: view '%s' overlaps no other, it gets no depth", view.name)
    tasks = [
        partial(_estimate, network, posed, sources[i], i, bounds[i], view)
        for i, view in enumerate(views)
    ]
    estimates: list[Estimate] = run_tasks(tasks)
    return estimates


@lru_cache(maxsize=1)
def _network(weights: str) -> IterMvs:
    return IterMvs(load(weights))


def _posed(network: IterMvs, view: View) -> Posed:
    """The view's features; its photo is resized to sides that the network accepts.

    Small photos are enlarged. Of the depths at structure-from-motion points, 25 to 85 % are within
    1 % with a longer side of 189 to 252 pixels, and 41 to 89 % with 448.
    """
    torch.set_num_threads(1)  # of this thread: other numbers of threads give other bits
    height, width = view.image.shape[1:]
    enlarged = max(1.0, LEAST_SIDE / max(height, width))
    sides = [max(2, round(enlarged * side / MULTIPLE)) * MULTIPLE for side in (height, width)]
    photo = F.interpolate(view.image[None], sides, mode="bicubic", antialias=True)[0].clamp(0, 1)
    K = view.camera.K.clone()
    K[0] *= sides[1] / view.camera.width
    K[1] *= sides[0] / view.camera.height
    return Posed(network.features(2 * photo - 1), K, view.camera.viewmat)


def _estimate(
    network: IterMvs,
    posed: Sequence[Posed],
    sources: Sequence[int],
    index: int,
    bounds: tuple[float, float],
    view: View,
) -> Estimate:
    torch.set_num_threads(1)
    width, height = view.camera.width, view.camera.height
    if not sources:
        return np.zeros((height, width), np.float32), np.zeros((height, width), np.float32)
    maps = network.depth(posed[index], [posed[s] for s in sources], *bounds)
    depth, confidence = (resample(m.double().numpy(), width, height) for m in maps)
    return depth.astype(np.float32), confidence.astype(np.float32)
