"""Convolution with 3x3 kernels in a quarter of the multiplications.

Source: Lavin and Gray 2016 (arXiv 1509.09308), F(4x4, 3x3). A tile of 4x4 outputs depends on 6x6
inputs d. With the kernel g and the constant matrices A, B and G,

    output = A^T [(G g G^T) * (B^T d B)] A,

where * is elementwise and summed over the input channels: 36 products of matrices [tiles, C] and
[C, K]. The tiles are processed in strips, so that these matrices stay in the cache. Rounding errors
are about 1e-5 of the largest output.

Feature maps are [H, W, C] float32, contiguous, with C a multiple of 16.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

from framework.compute.jit import inlined, kernel
from framework.compute.simd import LANES, fma, load, maximum, splat, store, zeros

STRIP = 65_536  # tiles of a strip times channels of input and output

_G = np.array([[6, 0, 0], [-4, -4, -4], [-4, 4, -4], [1, 2, 4], [1, -2, 4], [0, 0, 24]]) / 24
_G_KRON_G = torch.from_numpy(np.kron(_G, _G).astype(np.float32))

_f4 = np.float32
_MINUS_5, _MINUS_4, _2, _4, _8 = _f4(-5), _f4(-4), _f4(2), _f4(4), _f4(8)


def transformed(weight: Tensor) -> Tensor:
    """G g G^T of all kernels: [36, C, K] from `weight` [K, C, 3, 3]."""
    n_outputs, n_inputs = weight.shape[:2]
    kernels = weight.permute(2, 3, 1, 0).reshape(9, n_inputs * n_outputs)
    return torch.mm(_G_KRON_G, kernels).view(36, n_inputs, n_outputs)


def convolve(h: Tensor, filters: Tensor, bias: Tensor) -> Tensor:
    """Convolve with stride 1 and zero padding 1, add the bias and apply ReLU.

    Args:
        h: the input [H, W, C].
        filters: from `transformed`, [36, C, K].
        bias: [K].

    Returns:
        [H, W, K].
    """
    out, workspace = torch.empty(*h.shape[:2], len(bias)), torch.empty(36 * STRIP)
    n_inputs, n_outputs = filters.shape[1:]
    n_tiles = -(-h.shape[0] // 4) * -(-h.shape[1] // 4)
    most = STRIP // (n_inputs + n_outputs)
    for first in range(0, n_tiles, most):
        count = min(most, n_tiles - first)
        split = 36 * count * n_inputs
        inputs = workspace[:split].view(36, count, n_inputs)
        products = workspace[split:][: 36 * count * n_outputs].view(36, count, n_outputs)
        _transform_inputs(h.numpy(), first, inputs.numpy())
        torch.bmm(inputs, filters, out=products)
        _transform_outputs(products.numpy(), bias.numpy(), first, out.numpy())
    return out


@inlined
def _pixel(source: Any, at: Any, inside: Any) -> Any:
    return load(source, at) if inside else zeros()


@inlined
def _b_transposed(d: Any) -> Any:
    """B^T d."""
    d0, d1, d2, d3, d4, d5 = d
    even, odd = fma(splat(_MINUS_4), d2, d4), fma(splat(_MINUS_4), d1, d3)
    step, twice = d4 - d2, _2 * (d3 - d1)
    first = fma(splat(_4), d0, fma(splat(_MINUS_5), d2, d4))
    last = fma(splat(_4), d1, fma(splat(_MINUS_5), d3, d5))
    return first, even + odd, even - odd, step + twice, step - twice, last


@inlined
def _a_transposed(m: Any) -> Any:
    """A^T m."""
    m0, m1, m2, m3, m4, m5 = m
    sum1, sum2, difference1, difference2 = m1 + m2, m3 + m4, m1 - m2, m3 - m4
    return (
        m0 + sum1 + sum2,
        fma(splat(_2), difference2, difference1),
        fma(splat(_4), sum2, sum1),
        fma(splat(_8), difference2, difference1) + m5,
    )


@inlined
def _six(source: Any, at: Any, step: Any) -> Any:
    """Six vectors, `step` apart."""
    return (
        load(source, at),
        load(source, at + step),
        load(source, at + 2 * step),
        load(source, at + 3 * step),
        load(source, at + 4 * step),
        load(source, at + 5 * step),
    )


@kernel
def _transform_inputs(h: Any, first: Any, out: Any) -> None:
    """B^T d B of the tiles from `first` on, into `out` [36, tiles, C]; d is zero outside of h."""
    height, width, n_channels = h.shape
    n_across, plane, row = -(-width // 4), out.shape[1] * n_channels, width * n_channels
    source, target = h.reshape(-1), out.reshape(-1)
    half = np.empty(36 * LANES, np.float32)  # B^T d
    for tile in range(out.shape[1]):
        top, left = 4 * ((first + tile) // n_across) - 1, 4 * ((first + tile) % n_across) - 1
        for c in range(0, n_channels, LANES):
            for x in range(6):
                at = (top * width + left + x) * n_channels + c
                n_rows = height - top if 0 <= left + x < width else 0
                pixels = (
                    _pixel(source, at, top >= 0 and n_rows > 0),
                    _pixel(source, at + row, n_rows > 1),
                    _pixel(source, at + 2 * row, n_rows > 2),
                    _pixel(source, at + 3 * row, n_rows > 3),
                    _pixel(source, at + 4 * row, n_rows > 4),
                    _pixel(source, at + 5 * row, n_rows > 5),
                )
                column = _b_transposed(pixels)
                for y in range(6):
                    store(half, (6 * y + x) * LANES, column[y])
            for y in range(6):
                values = _b_transposed(_six(half, 6 * y * LANES, LANES))
                for x in range(6):
                    store(target, (6 * y + x) * plane + tile * n_channels + c, values[x])


@kernel
def _transform_outputs(products: Any, bias: Any, first: Any, out: Any) -> None:
    """ReLU(A^T m A + bias) of the tiles from `first` on; m are `products` [36, tiles, K]."""
    height, width, n_channels = out.shape
    n_across, plane = -(-width // 4), products.shape[1] * n_channels
    source, target = products.reshape(-1), out.reshape(-1)
    half = np.empty(24 * LANES, np.float32)  # A^T m
    for tile in range(products.shape[1]):
        top, left = 4 * ((first + tile) // n_across), 4 * ((first + tile) % n_across)
        for c in range(0, n_channels, LANES):
            for x in range(6):
                column = _a_transposed(_six(source, x * plane + tile * n_channels + c, 6 * plane))
                for y in range(4):
                    store(half, (6 * y + x) * LANES, column[y])
            offset = load(bias, c)
            for y in range(min(4, height - top)):
                values = _a_transposed(_six(half, 6 * y * LANES, LANES))
                at = ((top + y) * width + left) * n_channels + c
                for x in range(min(4, width - left)):
                    store(target, at + x * n_channels, maximum(values[x] + offset, zeros()))
