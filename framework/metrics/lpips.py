"""LPIPS (Zhang et al. 2018, arXiv 1801.03924) from a file of weights, without torchvision.

The weights are those that `lpips_weights` fetched, or a state dict as the authors' package has it
(`torch.save(model.state_dict(), file)` of its VGG or AlexNet variant): convolutions
`net.slice<s>.<layer>.weight|bias`, channel weights `lin<i>.model.1.weight`, and
`scaling_layer.shift|scale`. The keys determine the backbone.

d(x, y) = sum over stages of mean over pixels of sum over channels of w_c (fx_c - fy_c)^2, with f
the features divided by their norm over channels. Images in [0, 1] are mapped to [-1, 1], as the
authors define it; `centred=False` feeds them in [0, 1], as many sparse-view papers do.

A distance is computed on one thread, so that its bits do not depend on the thread count; several
distances run in parallel. Layers of 3x3 kernels with many channels use `winograd`: for two images
of 504x378, VGG-16 then takes 61 of 231 GFLOP. The values are those of direct convolution to 1e-6.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from safetensors.torch import load_file
from torch import Tensor

from framework.compute.simd import LANES
from framework.errors import require
from framework.files.archives import open_zip
from framework.files.limits import WEIGHTS_BYTES
from framework.files.opened import file_size, reading
from framework.metrics.lpips_kernels import difference
from framework.metrics.values import Measurement, Missing
from framework.metrics.winograd import convolve, transformed

MOST_CHANNELS = 512  # of VGG-16's widest layer
BAND = 1 << 15  # pixels of feature maps computed at a time, which limits the memory


@dataclass(frozen=True)
class Backbone:
    """A convolutional network.

    Attributes:
        name: in tables.
        layers: for each stage, the indices of its convolutions.
        pool: kernel size of the max pooling, with stride 2.
        pooled_stages: stages that begin with a max pooling.
        kernels, strides, paddings: by layer index; 3, 1 and 1 where absent.
        min_size: smallest image in pixels.
    """

    name: str
    layers: tuple[tuple[int, ...], ...]
    pool: int
    pooled_stages: tuple[int, ...]
    kernels: dict[int, int]
    strides: dict[int, int]
    paddings: dict[int, int]
    min_size: int


VGG_LAYERS = ((0, 2), (5, 7), (10, 12, 14), (17, 19, 21), (24, 26, 28))
ALEX_LAYERS = ((0,), (3,), (6,), (8,), (10,))
BACKBONES = {
    "VGG-16": Backbone("VGG", VGG_LAYERS, 2, (1, 2, 3, 4), {}, {}, {}, 16),
    "AlexNet": Backbone("AlexNet", ALEX_LAYERS, 3, (1, 2), {0: 11, 3: 5}, {0: 4}, {0: 2, 3: 2}, 31),
}


class Lpips:
    """The metric with loaded weights; see the module's docstring."""

    def __init__(self, backbone: Backbone, weights: dict[str, Tensor]) -> None:
        self._backbone = backbone
        self.weights = weights
        self._filters: dict[str, Tensor] = {}
        self._filters_lock = threading.Lock()

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
            pair = [self._input(image, centred) for image in (x, y)]
            for stage in range(len(self._backbone.layers)):
                pair, distance = self._compare(pair, stage)
                total += distance
        return total

    def _input(self, image: np.ndarray, centred: bool) -> Tensor:
        """The scaled image [H, W, 3]."""
        h = torch.from_numpy(np.ascontiguousarray(image, np.float32))
        h = 2.0 * h - 1.0 if centred else h
        shift, scale = self.weights["scaling_layer.shift"], self.weights["scaling_layer.scale"]
        return (h - shift.view(3)) / scale.view(3)

    def _compare(self, pair: list[Tensor], stage: int) -> tuple[list[Tensor], float]:
        """The inputs [h, w, C] of the next stage, and the distance of the features of this one.

        The features are computed in bands of rows. Each convolution of a band needs one more row
        above and below.
        """
        n_rows, n_columns = pair[0].shape[:2]
        band = n_rows if self._backbone.strides else max(4, BAND // n_columns // 4 * 4)
        margin = len(self._backbone.layers[stage])
        weight = self.weights[f"lin{stage}.model.1.weight"].view(-1)
        total, n_pixels, pooled = 0.0, 0, []
        for top in range(0, n_rows, band):
            first = max(top - margin, 0)
            inputs = [h[first : top + band + margin] for h in pair]
            x, y = (self._features(h, stage)[top - first :][:band] for h in inputs)
            total += difference(x.numpy(), y.numpy(), weight.numpy())
            n_pixels += x.shape[0] * x.shape[1]
            pooled.append([self._pool(h, stage + 1) for h in (x, y)])
        return [torch.cat(bands) for bands in zip(*pooled, strict=True)], total / n_pixels

    def _features(self, h: Tensor, stage: int) -> Tensor:
        """The features [h, w, C] of a stage."""
        for layer in self._backbone.layers[stage]:
            h = self._convolve(h, f"net.slice{stage + 1}.{layer}", layer)
        return h

    def _pool(self, h: Tensor, stage: int) -> Tensor:
        """The input of `stage` from the features of the previous one."""
        if stage not in self._backbone.pooled_stages:
            return h
        return _channels_last(F.max_pool2d(_planar(h), self._backbone.pool, stride=2))

    def _convolve(self, h: Tensor, key: str, layer: int) -> Tensor:
        weight, bias = self.weights[f"{key}.weight"], self.weights[f"{key}.bias"]
        if weight.shape[2] == 3 and weight.shape[1] >= LANES:
            return convolve(h, self._transformed(key), bias)
        stride, padding = (
            values.get(layer, 1) for values in (self._backbone.strides, self._backbone.paddings)
        )
        # convolutions are fastest in this layout
        weight = weight.contiguous(memory_format=torch.channels_last)
        return _channels_last(F.conv2d(_planar(h), weight, bias, stride, padding)).relu_()

    def _transformed(self, key: str) -> Tensor:
        with self._filters_lock:
            if key not in self._filters:
                self._filters[key] = transformed(self.weights[f"{key}.weight"])
            return self._filters[key]


def _planar(h: Tensor) -> Tensor:
    """[H, W, C] as [1, C, H, W], channels last in memory."""
    return h[None].permute(0, 3, 1, 2)


def _channels_last(h: Tensor) -> Tensor:
    """The inverse of `_planar`, contiguous."""
    return h.permute(0, 2, 3, 1)[0].contiguous()


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
    return Lpips(backbone, _fitting(weights, backbone, path))


def _fitting(weights: dict[str, Tensor], backbone: Backbone, path: str | Path) -> dict[str, Tensor]:
    """The tensors of the network; UserError unless they are finite, of the shapes that kernels may
    read."""
    shapes: dict[str, tuple[int, ...]] = {
        f"scaling_layer.{name}": (1, 3, 1, 1) for name in ("shift", "scale")
    }
    n_inputs = 3
    for stage, layers in enumerate(backbone.layers):
        for layer in layers:
            key, size = f"net.slice{stage + 1}.{layer}", backbone.kernels.get(layer, 3)
            require(
                f"{key}.bias" in weights,
                "metrics.lpips_weights: expected the LPIPS state dict of VGG-16 or AlexNet, got"
                f" none of '{key}.bias' in '{path}'; save the whole model's state_dict()",
            )
            n_outputs = weights[f"{key}.bias"].numel()
            require(
                n_outputs in range(LANES, MOST_CHANNELS + 1, LANES),
                f"metrics.lpips_weights: expected a multiple of {LANES} channels, at most"
                f" {MOST_CHANNELS}, in layer '{key}' of '{path}', got {n_outputs}; use the weights"
                " of VGG-16 or AlexNet",
            )
            shapes[f"{key}.bias"] = (n_outputs,)
            shapes[f"{key}.weight"] = (n_outputs, n_inputs, size, size)
            n_inputs = n_outputs
        shapes[f"lin{stage}.model.1.weight"] = (1, n_inputs, 1, 1)
    for key, shape in shapes.items():
        value = weights.get(key, torch.empty(0))
        require(
            value.shape == shape and bool(value.sum().isfinite()),
            f"metrics.lpips_weights: expected the finite weights of one network in '{path}', but"
            f" '{key}' should have the shape {shape} and has {tuple(value.shape)}; save the whole"
            " model's state_dict()",
        )
    return {key: weights[key] for key in shapes}


def _tensors(file: Path) -> dict[str, Tensor]:
    # strangers' weights: weights_only refuses code, open_zip what would unpack to too much
    where = f"metrics.lpips_weights={file}"
    with reading(where, "a state dict", "save it with torch.save(model.state_dict(), file)"):
        if file.suffix == ".safetensors":
            file_size(file, WEIGHTS_BYTES)
            loaded = load_file(file)
        else:
            open_zip(file, WEIGHTS_BYTES).close()
            loaded = torch.load(file, map_location="cpu", weights_only=True)
        tensors = {str(key): value.detach() for key, value in loaded.items()}
        n_bytes = 4 * sum(value.numel() for value in tensors.values())  # stored may be less
    require(
        n_bytes <= WEIGHTS_BYTES,
        f"{where}: expected tensors of at most {WEIGHTS_BYTES:,} bytes, got {n_bytes:,}; save the"
        " model's state_dict() alone",
    )
    return {key: value.float().contiguous() for key, value in tensors.items()}


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
