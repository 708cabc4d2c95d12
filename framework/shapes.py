"""Checks of type, shape and numbers of values from files and plugins.

Each raises ValueError with `where`, what was expected and what came. Checkpoints may be forged, and
kernels do not check lengths and indices.
"""

from __future__ import annotations

import math
import sys
from typing import Any

import torch
from torch import Tensor

from framework.types import Camera, Gaussians, View


def check_kind(where: str, value: object, *kinds: type) -> None:
    """`value` is exactly of one of these types: True is no int here."""
    if type(value) not in kinds:
        names = " or ".join(kind.__name__ for kind in kinds)
        raise ValueError(f"{where}: expected {names}, got {type(value).__name__}")


def check_count(where: str, value: object, most: int | None = None) -> None:
    """`value` is an integer from 0 to `most`."""
    top = 2**62 if most is None else most
    if type(value) is not int or not 0 <= value <= top:
        raise ValueError(f"{where}: expected an integer from 0 to {top}, got {value!r:.40}")


def check_number(where: str, value: object, least: float = -math.inf) -> None:
    """`value` is a finite int or float of at least `least`."""
    largest = sys.float_info.max  # an int may be beyond it
    if type(value) not in (int, float) or not max(least, -largest) <= value <= largest:  # type: ignore[operator]
        raise ValueError(f"{where}: expected a finite number >= {least}, got {value!r:.40}")


def check_tensor(
    where: str, value: object, *shape: int | None, dtype: torch.dtype = torch.float32
) -> None:
    """`value` is a contiguous tensor of this dtype and shape, None for any length; no NaN in it."""
    wanted = f"{str(dtype).removeprefix('torch.')} {_text(shape)}"
    if not isinstance(value, Tensor):
        raise ValueError(f"{where}: expected {wanted}, got {type(value).__name__}")
    fits = value.dim() == len(shape) and all(
        n in (None, size) for n, size in zip(shape, value.shape, strict=True)
    )
    if not fits or value.dtype != dtype:
        got = f"{str(value.dtype).removeprefix('torch.')} {_text(value.shape)}"
        raise ValueError(f"{where}: expected {wanted}, got {got}")
    if not value.is_contiguous():
        raise ValueError(f"{where}: expected it contiguous, got strides {value.stride()}")
    # the least of values is NaN if one of them is; found without a mask as large as the tensor
    if dtype.is_floating_point and value.numel() and math.isnan(value.amin()):
        raise ValueError(f"{where}: expected numbers, got NaN")


def check_finite(where: str, value: Tensor) -> None:
    """There is no infinity in `value`, which has no NaN."""
    if value.numel():
        least, most = value.aminmax()  # one pass, and no mask as large as the tensor
        if not math.isfinite(least) or not math.isfinite(most):
            raise ValueError(f"{where}: expected finite numbers, got infinity")


def check_gaussians(where: str, value: object, n: int | None, terms: int | None) -> None:
    """`value` are `n` Gaussians (None: one or more) of finite float32 with `terms` = K - 1
    coefficients of SH beyond the first (None: those of any degree to 3)."""
    if not isinstance(value, Gaussians):
        raise ValueError(f"{where}: expected Gaussians, got {type(value).__name__}")
    check_tensor(f"{where}.means", value.means, n, 3)
    count = len(value.means)
    if count == 0:
        raise ValueError(f"{where}: expected at least one Gaussian, got none")
    check_tensor(f"{where}.quats", value.quats, count, 4)
    check_tensor(f"{where}.log_scales", value.log_scales, count, 3)
    check_tensor(f"{where}.opacity_logits", value.opacity_logits, count)
    check_tensor(f"{where}.sh0", value.sh0, count, 1, 3)
    check_tensor(f"{where}.shN", value.shN, None, terms, 3)
    check_count(f"{where}.shN", len(value.shN), count)
    if value.shN.shape[1] not in (0, 3, 8, 15):
        raise ValueError(f"{where}.shN: expected 0, 3, 8 or 15 terms, got {value.shN.shape[1]}")
    for name, tensor in value.items():
        check_finite(f"{where}.{name}", tensor)


def check_camera(where: str, value: object) -> None:
    """`value` is a camera with a size of whole pixels; a `Camera` itself checks the rest."""
    if not isinstance(value, Camera):
        raise ValueError(f"{where}: expected a Camera, got {type(value).__name__}")
    check_count(f"{where}.width", value.width)
    check_count(f"{where}.height", value.height)


def check_view(where: str, value: object) -> None:
    """`value` is a view whose image, mask and depth have its camera's size."""
    if not isinstance(value, View):
        raise ValueError(f"{where}: expected a View, got {type(value).__name__}")
    check_kind(f"{where}.name", value.name, str)
    check_camera(f"{where}.camera", value.camera)
    size = value.camera.height, value.camera.width
    check_tensor(f"{where}.image", value.image, 3, *size)
    check_finite(f"{where}.image", value.image)
    for name in ("mask", "depth"):
        plane: Any = getattr(value, name)
        if plane is not None:
            check_tensor(f"{where}.{name}", plane, *size)
    check_number(f"{where}.weight", value.weight, least=0)
    check_kind(f"{where}.tags", value.tags, tuple)
    for tag in value.tags:
        check_kind(f"{where}.tags", tag, str)


def _text(shape: tuple[int | None, ...] | torch.Size) -> str:
    return f"[{', '.join('?' if n is None else str(n) for n in shape)}]"
