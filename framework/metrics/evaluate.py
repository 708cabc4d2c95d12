"""Image metrics and their protocol. Evaluation reads what is saved: images are quantised to 8 bits
first, so every number here can be recomputed from the PNG files of a run.

Inputs are planar torch images `[3, H, W]`, display-referred sRGB in [0, 1]; values outside are
clamped by the quantisation. A view is measured alone; means over views are taken by the record.

PSNR   10 log10(1 / MSE) in dB; MSE over all pixels and channels, peak 1.
SSIM   Wang et al. 2004: 11 x 11 Gaussian window, sigma 1.5, population covariance, K1 = .01,
       K2 = .03, peak 1; per channel, mean over channels and over the pixels whose window lies
       inside the image (a border of 5 px is left out), hence independent of any padding.
FLIP   Andersson et al. 2020, LDR, 67 pixels per degree, see `framework.metrics.flip`; float64 mean
       of the error map.
LPIPS  Zhang et al. 2018, see `framework.metrics.lpips`; only with weights, fetched or by path.
       `lpips`: images mapped to [-1, 1], as its authors do; `lpips_01`: fed in [0, 1], as many
       papers do, whose figures can be compared with no other.

With a mask (1 = valid, threshold 0.5): PSNR over the valid pixels; the others are set to white in
both images for SSIM, FLIP and LPIPS, as the DTU protocol of sparse-view work does.

A metric that has no finite value is a `Missing` with its reason, never NaN. torch is not imported
here, so that reading records stays light.
"""

from __future__ import annotations

import functools
import math
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, ParamSpec, Protocol

import numpy as np

from framework.compute import parallel
from framework.errors import printable_line
from framework.metrics.values import LARGEST, Measurement, Missing, ViewMetrics

if TYPE_CHECKING:
    from torch import Tensor

    from framework.metrics.lpips import Lpips
    from framework.types import Camera, View


class Measure(Protocol):
    """A metric that a plugin brings, `framework.plugin.Metric`."""

    def measure(self, render: Tensor, truth: Tensor, mask: Tensor | None) -> float: ...


P = ParamSpec("P")
SSIM_WINDOW = 11
FETCH_LPIPS = "fishersplat fetch lpips"  # the command that fetches its weights


NO_LPIPS = Missing(
    f"no weights in use; fetch them once with `{FETCH_LPIPS}`, or set metrics.lpips_weights to a"
    " state dict file"
)


def finite(metric: str) -> Callable[[Callable[P, Measurement]], Callable[P, Measurement]]:
    """A measurement named `metric` with Missing where it has no finite value: a record cannot hold
    one."""

    def wrap(measure: Callable[P, Measurement]) -> Callable[P, Measurement]:
        @functools.wraps(measure)
        def measured(*args: P.args, **kwargs: P.kwargs) -> Measurement:
            return _finite(measure(*args, **kwargs), metric)

        return measured

    return wrap


def _finite(value: Measurement, metric: str) -> Measurement:
    if isinstance(value, Missing) or abs(value) <= LARGEST:  # false for NaN
        return value
    beyond = f"a value beyond {LARGEST:g}" if math.isfinite(value) else "no finite value"
    return Missing(f"{metric} gave {beyond}")


def quantise(image: Tensor) -> np.ndarray:
    """[H, W, 3] uint8, round-to-nearest of the clamped planar `image` [3, H, W]; NaN becomes 0."""
    if image.ndim != 3 or image.shape[0] != 3:
        raise ValueError(f"metrics: expected an image [3, H, W], got shape {tuple(image.shape)}")
    pixels = image.detach().cpu().double().nan_to_num(nan=0.0).clamp_(0.0, 1.0)
    levels: np.ndarray = pixels.mul_(255.0).round_().byte().permute(1, 2, 0).contiguous().numpy()
    return levels


def psnr(render: Tensor, truth: Tensor, mask: Tensor | None = None) -> Measurement:
    """Peak signal-to-noise ratio in dB of [3, H, W] images; mask: [H, W]."""
    return _psnr(*_pair(render, truth, mask))


def ssim(render: Tensor, truth: Tensor, mask: Tensor | None = None) -> Measurement:
    """Structural similarity of [3, H, W] images; mask: [H, W]. Missing below 11 x 11 pixels."""
    return _ssim(*_pair(render, truth, mask)[:2])


def flip(render: Tensor, truth: Tensor, mask: Tensor | None = None) -> Measurement:
    """Mean LDR-FLIP error of [3, H, W] images, 0 = no visible difference; mask: [H, W]."""
    return _flip(*_pair(render, truth, mask)[:2])


def lpips(
    render: Tensor,
    truth: Tensor,
    network: Lpips | None,
    mask: Tensor | None = None,
    centred: bool = True,
) -> Measurement:
    """LPIPS of [3, H, W] images by `network` (`framework.metrics.lpips.load`), Missing without one.
    centred: see `Lpips.distance`."""
    return lpips_of(*_pair(render, truth, mask)[:2], network, centred)


def evaluate_view(
    view: View, render: Tensor, render_s: float = 0.0, network: Lpips | None = None
) -> ViewMetrics:
    """All metrics of the `render` [3, H, W] of a test view, both quantised to 8 bits first.

    Raises ValueError when the sizes differ.
    """
    return _measured([(view, render, render_s)], network, {})[0]


def evaluate(
    render: Callable[[Camera], Tensor],
    views: Sequence[View],
    network: Lpips | None = None,
    also: Mapping[str, Measure] | None = None,
) -> tuple[list[ViewMetrics], list[tuple[View, Tensor]]]:
    """Render and measure every test view; also gives the (view, [3, H, W] image) pairs to save.

    also: name -> further metrics, see `framework.plugin.Metric`.
    """
    timed: list[tuple[View, Tensor, float]] = []
    for view in views:
        start = time.perf_counter()
        image = render(view.camera).detach()
        timed.append((view, image, time.perf_counter() - start))
    return _measured(timed, network, also or {}), [(view, image) for view, image, _ in timed]


def _measured(
    renders: Sequence[tuple[View, Tensor, float]],
    network: Lpips | None,
    also: Mapping[str, Measure],
) -> list[ViewMetrics]:
    """The metrics of (view, render [3, H, W], seconds)."""
    pairs = parallel.run_tasks([partial(_pair, r, view.image, view.mask) for view, r, _ in renders])
    # the longest first, so that no thread is left alone with one at the end
    kinds: list[Callable[..., Measurement]] = [
        *(partial(lpips_of, network=network, centred=centred) for centred in (True, False)),
        *(_ssim, _flip),
    ]
    found = iter(parallel.run_tasks([partial(kind, x, y) for kind in kinds for x, y, _ in pairs]))
    centred, fed, ssims, flips = ([next(found) for _ in pairs] for _ in kinds)
    return [
        ViewMetrics(
            view=view.name,
            tags=tuple(view.tags),
            psnr=_psnr(x, y, valid),
            ssim=ssims[i],
            flip=flips[i],
            lpips=centred[i],
            lpips_01=fed[i],
            render_s=render_s,
            also={name: plugged(name, one, x, y, valid) for name, one in also.items()},
        )
        for i, ((view, _, render_s), (x, y, valid)) in enumerate(zip(renders, pairs, strict=True))
    ]


def plugged(
    name: str, metric: Measure, x: np.ndarray, y: np.ndarray, valid: np.ndarray | None
) -> Measurement:
    """A plugin's metric of two [H, W, 3] uint8 images: whatever it does wrong costs no training."""
    import torch

    def planar(image: np.ndarray) -> Tensor:
        return torch.from_numpy(image.transpose(2, 0, 1).astype(np.float32) / 255)

    mask = None if valid is None else torch.from_numpy(valid.copy())
    try:
        return _finite(float(metric.measure(planar(x), planar(y), mask)), name)
    except (Exception, SystemExit) as error:  # whatever somebody else's code raises
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
        return _finite(
            float(np.mean(np.asarray(values, dtype=np.float64))), f"the mean of {metric}"
        )


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
    if valid.shape != x.shape[:2]:
        raise ValueError(f"metrics: expected a mask {x.shape[:2]}, got {valid.shape}")
    x[~valid], y[~valid] = 255, 255
    return x, y, valid


@finite("PSNR")
def _psnr(x: np.ndarray, y: np.ndarray, valid: np.ndarray | None) -> Measurement:
    count = x.size if valid is None else 3 * int(valid.sum())
    if count == 0:
        return Missing("the mask has no valid pixel")
    difference = np.subtract(x, y, dtype=np.int64)  # 0 where not valid
    squares = int(np.vdot(difference, difference))
    if squares == 0:
        return Missing("infinite: render equals truth")
    return 10.0 * math.log10(255.0**2 * count / squares)


@finite("SSIM")
def _ssim(x: np.ndarray, y: np.ndarray) -> Measurement:
    if min(x.shape[:2]) < SSIM_WINDOW:
        return Missing(f"image of {x.shape[1]}x{x.shape[0]} is smaller than the 11x11 window")
    from skimage.metrics import structural_similarity

    return float(
        structural_similarity(
            x / 255.0,
            y / 255.0,
            gaussian_weights=True,
            sigma=1.5,
            use_sample_covariance=False,
            data_range=1.0,
            channel_axis=2,
        )
    )


@finite("FLIP")
def _flip(x: np.ndarray, y: np.ndarray) -> Measurement:
    from framework.metrics.flip import error_map

    return float(error_map(y, x).mean(dtype=np.float64))


@finite("LPIPS")
def lpips_of(x: np.ndarray, y: np.ndarray, network: Lpips | None, centred: bool) -> Measurement:
    """LPIPS of two [H, W, 3] uint8 images."""
    if network is None:
        return NO_LPIPS
    return network.distance(x / 255.0, y / 255.0, centred)
