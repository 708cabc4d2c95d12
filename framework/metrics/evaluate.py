"""Image metrics. All read images quantised to 8 bits, so that every number can be recomputed from
the PNG files of a run.

Inputs are planar torch images `[3, H, W]`, display-referred sRGB in [0, 1]; quantisation clamps
values outside. Each view is measured alone; the record holds the means over views.

PSNR   10 log10(1 / MSE) in dB; MSE over all pixels and channels, peak 1.
SSIM   Wang et al. 2004: 11 x 11 Gaussian window, sigma 1.5, population covariance, K1 = .01,
       K2 = .03, peak 1; mean over channels and over the pixels whose window lies inside the image
       (a border of 5 px is left out), hence independent of any padding.
FLIP   Andersson et al. 2020, LDR, 67 pixels per degree, see `framework.metrics.flip`; float64 mean
       of the error map.
LPIPS  Zhang et al. 2018, see `framework.metrics.lpips`; needs weights, fetched or by path.
       `lpips` maps images to [-1, 1], as its authors do. `lpips_01` feeds them in [0, 1], as many
       papers do; the two are not comparable. It costs as much again, so it is measured on request.

With a mask (1 = valid, threshold 0.5), PSNR covers the valid pixels. For SSIM, FLIP and LPIPS the
other pixels are set to white in both images, as in the DTU protocol of sparse-view papers.

A metric without a finite value is a `Missing` with its reason, never NaN. torch is not imported
at import time, so that reading records stays light.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Protocol

import numpy as np

from framework.compute import parallel
from framework.errors import printable_line
from framework.metrics.values import LARGEST, NOT_REQUESTED, Measurement, Missing, ViewMetrics

if TYPE_CHECKING:
    from torch import Tensor

    from framework.metrics.lpips import Lpips
    from framework.types import Camera, View

SSIM_WINDOW = 11
FETCH_LPIPS = "fishersplat fetch lpips"
NO_LPIPS = Missing(
    f"no weights in use; fetch them once with `{FETCH_LPIPS}`, or set metrics.lpips_weights to a"
    " state dict file"
)
REPORT_S = 2.0  # seconds between two lines about the progress of LPIPS


class Measure(Protocol):
    """A metric from a plugin, see `framework.plugin.Metric`."""

    def measure(self, render: Tensor, truth: Tensor, mask: Tensor | None) -> float: ...


def quantise(image: Tensor) -> np.ndarray:
    """Round the clamped planar `image` [3, H, W] to [H, W, 3] uint8; NaN becomes 0."""
    if image.ndim != 3 or image.shape[0] != 3:
        raise ValueError(f"metrics: expected an image [3, H, W], got shape {tuple(image.shape)}")
    pixels = image.detach().cpu().double().nan_to_num(nan=0.0).clamp_(0.0, 1.0)
    levels: np.ndarray = pixels.mul_(255.0).round_().byte().permute(1, 2, 0).contiguous().numpy()
    return levels


def psnr(render: Tensor, truth: Tensor, mask: Tensor | None = None) -> Measurement:
    """Peak signal-to-noise ratio in dB of [3, H, W] images.

    Args:
        mask: [H, W].
    """
    return _psnr(*_pair(render, truth, mask))


def evaluate(
    render: Callable[[Camera], Tensor],
    views: Sequence[View],
    network: Lpips | None = None,
    also: Mapping[str, Measure] | None = None,
    both: bool = False,
    report: Callable[[str], None] | None = None,
) -> tuple[list[ViewMetrics], list[tuple[View, Tensor]]]:
    """Render and measure every test view.

    Args:
        render: renders a camera to an image [3, H, W].
        views: the test views.
        network: measures LPIPS; None leaves it out.
        also: name -> further metrics, see `framework.plugin.Metric`.
        both: also measure LPIPS of images fed in [0, 1].
        report: called now and then with a line about the progress of LPIPS.

    Returns:
        The metrics of each view, and the (view, image [3, H, W]) pairs to save.
    """
    timed: list[tuple[View, Tensor, float]] = []
    for view in views:
        start = time.perf_counter()
        image = render(view.camera).detach()
        timed.append((view, image, time.perf_counter() - start))
    metrics = _measured(timed, network, also, both, report)
    return metrics, [(view, image) for view, image, _ in timed]


def _measured(
    renders: Sequence[tuple[View, Tensor, float]],
    network: Lpips | None = None,
    also: Mapping[str, Measure] | None = None,
    both: bool = False,
    report: Callable[[str], None] | None = None,
) -> list[ViewMetrics]:
    """The metrics of (view, render [3, H, W], seconds)."""
    pairs = parallel.run_tasks([partial(_pair, r, view.image, view.mask) for view, r, _ in renders])
    images = [(x, y) for x, y, _ in pairs]
    # the longest first, so that all threads end at about the same time
    tasks = _lpips_tasks(images, network, both, report)
    tasks["ssim"] = [partial(_ssim, *pair) for pair in images]
    tasks["flip"] = [partial(_flip, *pair) for pair in images]
    values = _run(tasks)
    return [
        ViewMetrics(
            view=view.name,
            tags=tuple(view.tags),
            psnr=_psnr(x, y, valid),
            ssim=values["ssim"][i],
            flip=values["flip"][i],
            lpips=values["lpips"][i],
            lpips_01=values["lpips_01"][i],
            render_s=render_s,
            also={name: plugged(name, m, x, y, valid) for name, m in (also or {}).items()},
        )
        for i, ((view, _, render_s), (x, y, valid)) in enumerate(zip(renders, pairs, strict=True))
    ]


def plugged(
    name: str, metric: Measure, x: np.ndarray, y: np.ndarray, valid: np.ndarray | None
) -> Measurement:
    """A plugin's metric of two [H, W, 3] uint8 images. An error in it must not cost a training."""
    import torch

    def planar(image: np.ndarray) -> Tensor:
        return torch.from_numpy(image.transpose(2, 0, 1).astype(np.float32) / 255)

    mask = None if valid is None else torch.from_numpy(valid.copy())
    try:
        return _finite(float(metric.measure(planar(x), planar(y), mask)), name)
    except (Exception, SystemExit) as error:
        return Missing(printable_line(f"{name} raised {type(error).__name__}: {error}"))


def mean_of(metrics: Sequence[ViewMetrics], metric: str) -> Measurement:
    """Mean over the views; Missing, with the first reason, unless every view has a value."""
    values = [m.value(metric) for m in metrics]
    missing = [v for v in values if isinstance(v, Missing)]
    if not values:
        return Missing("no test views")
    if len(missing) == len(values):
        return missing[0]
    if missing:
        return Missing(f"{missing[0].reason} ({len(missing)} of {len(values)} views)")
    with np.errstate(over="ignore"):
        mean = float(np.mean(np.asarray(values, dtype=np.float64)))
    return _finite(mean, f"the mean of {metric}")


def lpips_of(
    images: Sequence[tuple[np.ndarray, np.ndarray]],
    network: Lpips | None,
    both: bool = False,
    report: Callable[[str], None] | None = None,
) -> dict[str, list[Measurement]]:
    """Measure LPIPS of (render, truth) pairs of [H, W, 3] uint8 images.

    Returns:
        The values of `lpips` and `lpips_01`; the latter are Missing unless `both` is set.
    """
    return _run(_lpips_tasks(images, network, both, report))


def _lpips_tasks(
    images: Sequence[tuple[np.ndarray, np.ndarray]],
    network: Lpips | None,
    both: bool,
    report: Callable[[str], None] | None,
) -> dict[str, list[Callable[[], Measurement]]]:
    count = _Count(len(images) * (1 + both), report or (lambda text: None))

    def distance(x: np.ndarray, y: np.ndarray, centred: bool) -> Measurement:
        if network is None:
            return NO_LPIPS
        if not (centred or both):
            return NOT_REQUESTED
        value = _finite(network.distance(x / 255.0, y / 255.0, centred), "LPIPS")
        count.add()
        return value

    return {
        "lpips": [partial(distance, *pair, True) for pair in images],
        "lpips_01": [partial(distance, *pair, False) for pair in images],
    }


def _run(
    tasks: Mapping[str, Sequence[Callable[[], Measurement]]],
) -> dict[str, list[Measurement]]:
    """Run all tasks on the kernels' threads and return their values under the same names."""
    values = iter(parallel.run_tasks([task for named in tasks.values() for task in named]))
    return {name: [next(values) for _ in named] for name, named in tasks.items()}


class _Count:
    """Reports how many of `total` images are measured, at most every `REPORT_S` seconds."""

    def __init__(self, total: int, report: Callable[[str], None]) -> None:
        self.total, self.report = total, report
        self.done, self.reported_at = 0, time.monotonic()
        self.lock = threading.Lock()

    def add(self) -> None:
        """Count one more image; called from several threads."""
        with self.lock:
            self.done += 1
            if time.monotonic() - self.reported_at >= REPORT_S:
                self.reported_at = time.monotonic()
                self.report(f"evaluation · LPIPS {self.done}/{self.total} images")


def _pair(
    render: Tensor, truth: Tensor, mask: Tensor | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """Both images as [H, W, 3] uint8, white where not valid, and the valid pixels [H, W]."""
    if render.shape != truth.shape:
        raise ValueError(
            f"metrics: expected a render of the truth's shape {tuple(truth.shape)},"
            f" got {tuple(render.shape)}"
        )
    x, y = quantise(render), quantise(truth)
    if mask is None:
        return x, y, None
    valid = mask.detach().cpu().numpy() > 0.5
    x[~valid], y[~valid] = 255, 255
    return x, y, valid


def _finite(value: Measurement, metric: str) -> Measurement:
    """`value`, or Missing if it is not finite: a record cannot hold one."""
    if isinstance(value, Missing) or abs(value) <= LARGEST:  # false for NaN
        return value
    beyond = f"a value beyond {LARGEST:g}" if math.isfinite(value) else "no finite value"
    return Missing(f"{metric} gave {beyond}")


def _psnr(x: np.ndarray, y: np.ndarray, valid: np.ndarray | None) -> Measurement:
    count = x.size if valid is None else 3 * int(valid.sum())
    if count == 0:
        return Missing("the mask has no valid pixel")
    difference = np.subtract(x, y, dtype=np.int64)  # 0 where not valid
    squares = int(np.vdot(difference, difference))
    if squares == 0:
        return Missing("infinite: render equals truth")
    return 10.0 * math.log10(255.0**2 * count / squares)


def _ssim(x: np.ndarray, y: np.ndarray) -> Measurement:
    if min(x.shape[:2]) < SSIM_WINDOW:
        return Missing(f"image of {x.shape[1]}x{x.shape[0]} is smaller than the 11x11 window")
    from skimage.metrics import structural_similarity

    similarity = structural_similarity(
        x / 255.0,
        y / 255.0,
        gaussian_weights=True,
        sigma=1.5,
        use_sample_covariance=False,
        data_range=1.0,
        channel_axis=2,
    )
    return _finite(float(similarity), "SSIM")


def _flip(x: np.ndarray, y: np.ndarray) -> Measurement:
    from framework.metrics.flip import error_map

    return _finite(float(error_map(y, x).mean(dtype=np.float64)), "FLIP")
