"""LPIPS (Zhang et al. 2018, arXiv 1801.03924) from a file of weights, without torchvision.

The weights are those that `lpips_weights` fetched, or a state dict as the authors' package has it
(`torch.save(model.state_dict(), file)` of its VGG or AlexNet variant): convolutions
`net.slice<s>.<layer>.weight|bias`, channel weights `lin<i>.model.1.weight`, and
`scaling_layer.shift|scale`. The backbone is told from the keys.

d(x, y) = sum over stages of mean over pixels of sum over channels of w_c (fx_c - fy_c)^2, with f
the features divided by their norm over channels. Images in [0, 1] are mapped to [-1, 1], as the
authors define it; figures in sparse-view papers are often made with [0, 1] fed directly and differ
(`centred=False`).

Every distance is computed on one thread, so that its bits depend on no thread count; several run
beside each other as tasks. Two images of 504x378 take VGG-16 233 GFLOP and about 250 MB.
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
    """name: in tables. layers: per stage the indices of its convolutions. pool: kernel of the
    stride-2 max pooling before a stage that has one. strides, paddings: by layer index, else 1 and
    1."""

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
    """The metric with loaded weights; see the module's text."""

    def __init__(self, backbone: Backbone, weights: dict[str, Tensor]) -> None:
        self._backbone = backbone
        # the layout that convolutions are fastest in
        self.weights = {
            key: value.contiguous(memory_format=torch.channels_last) if value.ndim == 4 else value
            for key, value in weights.items()
        }

    @property
    def name(self) -> str:
        """The backbone's, for tables."""
        return self._backbone.name

    def distance(self, x: np.ndarray, y: np.ndarray, centred: bool = True) -> Measurement:
        """LPIPS of two [H, W, 3] float images in [0, 1]; Missing where they are too small.

        centred: map them to [-1, 1] first, as the authors do; else they are fed as they are.
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
        """[1, 3, H, W], channels last in memory."""
        h = torch.from_numpy(np.ascontiguousarray(image, np.float32))[None].permute(0, 3, 1, 2)
        h = 2.0 * h - 1.0 if centred else h
        return (h - self.weights["scaling_layer.shift"]) / self.weights["scaling_layer.scale"]

    def _stage(self, h: Tensor, stage: int) -> Tensor:
        """[1, C, h, w] after the last ReLU of a stage, from that of the stage before."""
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
    """The metric from a state dict file. Raises UserError for a missing or unsuitable file."""
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
    _try(network, backbone, path)
    return network


def _try(network: Lpips, backbone: Backbone, path: str | Path) -> None:
    """Raise UserError unless the weights fit each other: the smallest image passes through."""
    image = np.full((backbone.min_size, backbone.min_size, 3), 0.5)
    wide = [k for k, w in network.weights.items() if max((*w.shape, 1)) > MOST_CHANNELS]
    try:
        if wide:
            raise ValueError(f"{wide[0]} has more than {MOST_CHANNELS} channels")
        got = network.distance(image, 1.0 - image)
        if not isinstance(got, float) or not math.isfinite(got):
            raise ValueError("they give no finite distance")
    except (RuntimeError, ValueError, IndexError) as error:
        reason = re.sub(r"\s+", " ", str(error))[:120]
        raise UserError(
            f"metrics.lpips_weights: expected the weights of one network in '{path}', got some that"
            f" do not fit each other ({reason}); save the whole model's state_dict()"
        ) from None


def _tensors(file: Path) -> dict[str, Tensor]:
    # weights_only refuses pickled code, and open_zip what would unpack to too much: a weights file
    # is data from elsewhere. PyTorch writes zip archives since 1.6
    try:
        if file.suffix == ".safetensors":
            file_size(file, WEIGHTS_BYTES)
            loaded = load_file(file)
        else:
            open_zip(file, WEIGHTS_BYTES).close()
            loaded = torch.load(file, map_location="cpu", weights_only=True)
    except Exception as error:
        reason = re.sub(r"\s+", " ", str(error))[:120]
        raise UserError(
            f"metrics.lpips_weights: '{file}' is not a readable state dict ({reason}); save it with"
            " torch.save(model.state_dict(), file)"
        ) from error
    require(
        isinstance(loaded, dict) and all(isinstance(v, Tensor) for v in loaded.values()),
        f"metrics.lpips_weights: expected a dict of tensors in '{file}', got"
        f" {type(loaded).__name__}; save it with torch.save(model.state_dict(), file)",
    )
    n_bytes = 4 * sum(value.numel() for value in loaded.values())  # a view may stand for much more
    require(
        n_bytes <= WEIGHTS_BYTES and all(isinstance(key, str) for key in loaded),
        f"metrics.lpips_weights: expected tensors of at most {WEIGHTS_BYTES:,} bytes in '{file}',"
        f" got {n_bytes:,}; save the model's state_dict() alone",
    )
    return {key: value.float() for key, value in loaded.items()}


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
    """The mean over pixels of sum_c weight_c (x_c / |x| - y_c / |y|)^2 of features [1, C, h, w],
    of which a few rows at a time are summed up."""
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
    """What PyTorch does meanwhile on the calling thread it does on no other: sums that several
    threads share may come out differently. The number of threads is told by each thread for
    itself, and asking for it first settles it, before a task beside puts the number back."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
