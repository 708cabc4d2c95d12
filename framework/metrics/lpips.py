"""LPIPS (Zhang et al. 2018, arXiv 1801.03924) from a file of weights, without torchvision.

The weights are those that `lpips_weights` fetched, or a state dict as the authors' package has it
(`torch.save(model.state_dict(), file)` of its VGG or AlexNet variant): convolutions
`net.slice<s>.<layer>.weight|bias`, channel weights `lin<i>.model.1.weight`, and
`scaling_layer.shift|scale`. The keys determine the backbone.

d(x, y) = sum over stages of mean over pixels of sum over channels of w_c (fx_c - fy_c)^2, with f
the features divided by their norm over channels. Images in [0, 1] are mapped to [-1, 1], as the
authors define it; `centred=False` feeds them in [0, 1], as many sparse-view papers do.

A distance is computed on one thread, so that its bits do not depend on the thread count; several
distances run in parallel. VGG-16 takes 233 GFLOP and about 250 MB for two images of 504x378.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from safetensors.torch import load_file
from torch import Tensor

from framework.errors import UserError, require
from framework.files.archives import open_zip
from framework.files.limits import WEIGHTS_BYTES
from framework.files.opened import file_size
from framework.metrics.values import Measurement, Missing

MOST_CHANNELS = 512  # of VGG-16's widest layer
ROWS = 16  # of feature maps compared at a time, which then stay in the processor's cache
NORM_EPS = 1e-10  # keeps the division finite where no feature responds


@dataclass(frozen=True)
class Backbone:
    """A convolutional network.

    Attributes:
        name: in tables.
        layers: for each stage, the indices of its convolutions.
        pool: kernel size of the max pooling, with stride 2.
        pooled_stages: stages that begin with a max pooling.
        strides, paddings: by layer index; 1 where absent.
        min_size: smallest image in pixels.
    """

    name: str
    layers: tuple[tuple[int, ...], ...]
    pool: int
    pooled_stages: tuple[int, ...]
    strides: dict[int, int]
    paddings: dict[int, int]
    min_size: int


BACKBONES = {
    "VGG-16": Backbone(
        "VGG",
        ((0, 2), (5, 7), (10, 12, 14), (17, 19, 21), (24, 26, 28)),
        2,
        (1, 2, 3, 4),
        {},
        {},
        16,
    ),
    "AlexNet": Backbone(
        "AlexNet", ((0,), (3,), (6,), (8,), (10,)), 3, (1, 2), {0: 4}, {0: 2, 3: 2}, 31
    ),
}


class Lpips:
    """The metric with loaded weights; see the module's docstring."""

    def __init__(self, backbone: Backbone, weights: dict[str, Tensor]) -> None:
        self._backbone = backbone
        # convolutions are fastest in this layout
        self.weights = {
            key: value.contiguous(memory_format=torch.channels_last) if value.ndim == 4 else value
            for key, value in weights.items()
        }

    @property
    def name(self) -> str:
        """The backbone's name in tables."""
        return self._backbone.name

    def distance(self, x: np.ndarray, y: np.ndarray, centred: bool = True) -> Measurement:
        """LPIPS of two [H, W, 3] float images in [0, 1]; Missing if they are too small.

        Args:
            centred: map them to [-1, 1] first, as the authors do.
        """
        if min(x.shape[:2]) < self._backbone.min_size:
            return Missing(
                f"image of {x.shape[1]}x{x.shape[0]} is smaller than {self._backbone.min_size} px"
            )
        total = 0.0
        with torch.inference_mode(), _one_thread():
            hx, hy = self._input(x, centred), self._input(y, centred)
            for stage in range(len(self._backbone.layers)):
                hx, hy = self._stage(hx, stage), self._stage(hy, stage)
                total += _difference(hx, hy, self.weights[f"lin{stage}.model.1.weight"])
        return total

    def _input(self, image: np.ndarray, centred: bool) -> Tensor:
        """The scaled image [1, 3, H, W], channels last in memory."""
        h = torch.from_numpy(np.ascontiguousarray(image, np.float32))[None].permute(0, 3, 1, 2)
        h = 2.0 * h - 1.0 if centred else h
        return (h - self.weights["scaling_layer.shift"]) / self.weights["scaling_layer.scale"]

    def _stage(self, h: Tensor, stage: int) -> Tensor:
        """The features [1, C, h, w] of a stage from those of the previous one."""
        if stage in self._backbone.pooled_stages:
            h = F.max_pool2d(h, self._backbone.pool, stride=2)
        for layer in self._backbone.layers[stage]:
            h = self._convolve(h, stage, layer)
        return h

    def _convolve(self, h: Tensor, stage: int, layer: int) -> Tensor:
        key = f"net.slice{stage + 1}.{layer}"
        return F.conv2d(
            h,
            self.weights[f"{key}.weight"],
            self.weights[f"{key}.bias"],
            stride=self._backbone.strides.get(layer, 1),
            padding=self._backbone.paddings.get(layer, 1),
        ).relu_()


def load(path: str | Path) -> Lpips:
    """Load the metric from a state dict file.

    Raises:
        UserError: the file is missing or unsuitable.
    """
    file = Path(path)
    require(
        file.is_file(),
        f"metrics.lpips_weights: expected a state dict file, got '{path}', which does not exist;"
        " give the path of the saved weights or null",
    )
    weights = _tensors(file)
    backbone = BACKBONES["VGG-16" if "net.slice2.5.weight" in weights else "AlexNet"]
    absent = sorted(_keys(backbone) - weights.keys())
    require(
        not absent,
        f"metrics.lpips_weights: expected the LPIPS state dict of VGG-16 or AlexNet, but '{path}'"
        f" lacks {len(absent)} tensors, first '{absent[0] if absent else ''}'; save the whole"
        " model's state_dict()",
    )
    network = Lpips(backbone, {key: weights[key] for key in _keys(backbone)})
    _check_fit(network, backbone, path)
    return network


def _check_fit(network: Lpips, backbone: Backbone, path: str | Path) -> None:
    """Raise UserError unless the smallest image passes through the network."""
    image = np.full((backbone.min_size, backbone.min_size, 3), 0.5)
    wide = [k for k, w in network.weights.items() if max((*w.shape, 1)) > MOST_CHANNELS]
    try:
        if wide:
            raise ValueError(f"{wide[0]} has more than {MOST_CHANNELS} channels")
        distance = network.distance(image, 1.0 - image)
        if not isinstance(distance, float) or not math.isfinite(distance):
            raise ValueError("they give no finite distance")
    except (RuntimeError, ValueError, IndexError) as error:
        raise UserError(
            f"metrics.lpips_weights: expected the weights of one network in '{path}', got some that"
            f" do not fit each other ({_short(error)}); save the whole model's state_dict()"
        ) from None


def _tensors(file: Path) -> dict[str, Tensor]:
    # strangers' weights: weights_only refuses code, open_zip what would unpack to too much
    try:
        if file.suffix == ".safetensors":
            file_size(file, WEIGHTS_BYTES)
            loaded = load_file(file)
        else:
            open_zip(file, WEIGHTS_BYTES).close()
            loaded = torch.load(file, map_location="cpu", weights_only=True)
    except Exception as error:
        raise UserError(
            f"metrics.lpips_weights: '{file}' is not a readable state dict ({_short(error)}); save"
            " it with torch.save(model.state_dict(), file)"
        ) from error
    require(
        isinstance(loaded, dict) and all(isinstance(v, Tensor) for v in loaded.values()),
        f"metrics.lpips_weights: expected a dict of tensors in '{file}', got"
        f" {type(loaded).__name__}; save it with torch.save(model.state_dict(), file)",
    )
    n_bytes = 4 * sum(value.numel() for value in loaded.values())  # stored may be less
    require(
        n_bytes <= WEIGHTS_BYTES and all(isinstance(key, str) for key in loaded),
        f"metrics.lpips_weights: expected tensors of at most {WEIGHTS_BYTES:,} bytes in '{file}',"
        f" got {n_bytes:,}; save the model's state_dict() alone",
    )
    return {key: value.float() for key, value in loaded.items()}


def _short(error: Exception) -> str:
    return re.sub(r"\s+", " ", str(error))[:120]


def _keys(backbone: Backbone) -> set[str]:
    convolutions = {
        f"net.slice{stage + 1}.{layer}.{kind}"
        for stage, layers in enumerate(backbone.layers)
        for layer in layers
        for kind in ("weight", "bias")
    }
    lins = {f"lin{stage}.model.1.weight" for stage in range(len(backbone.layers))}
    return convolutions | lins | {"scaling_layer.shift", "scaling_layer.scale"}


def _difference(x: Tensor, y: Tensor, weight: Tensor) -> float:
    """Mean over pixels of sum_c weight_c (x_c / |x| - y_c / |y|)^2 of features [1, C, h, w]."""
    n_rows, n_columns = x.shape[2:]
    total = 0.0
    for start in range(0, n_rows, ROWS):
        rows = slice(start, start + ROWS)
        difference = _normalise(x[:, :, rows]).sub_(_normalise(y[:, :, rows])).square_()
        total += float(difference.mul_(weight).sum(1).sum(dtype=torch.float64))
    return total / (n_rows * n_columns)


def _normalise(features: Tensor) -> Tensor:
    return features / (features.square().sum(1, keepdim=True).sqrt_() + NORM_EPS)


@contextmanager
def _one_thread() -> Iterator[None]:
    """Make PyTorch compute on the calling thread alone: sums split between threads may differ.

    The setting is per thread. Reading it first initialises it, so that restoring it in a parallel
    task cannot change it here.
    """
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
