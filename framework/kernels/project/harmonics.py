"""Real spherical harmonics of the degrees 1 to 3, with the signs of 3DGS, and their gradient.

The helpers are for float32 numbers and for vectors of them (`simd`) alike; `sh_color` and
`sh_backward` are for a chunk of 16 Gaussians.
"""

import math

import numpy as np

from framework.compute.jit import inlined
from framework.compute.simd import LANES, load16, store16, zeros

f4 = np.float32

# normalisation of the real spherical harmonics up to degree 3
Y0 = f4(0.28209479177387814)
_Y1 = f4(0.4886025119029199)
_Y2A, _Y2B, _Y2C = f4(1.0925484305920792), f4(0.31539156525252005), f4(0.5462742152960396)
_Y3A, _Y3B, _Y3C = f4(0.5900435899266435), f4(2.890611442640554), f4(0.4570457994644658)
_Y3D, _Y3E = f4(0.3731763325901154), f4(1.445305721320277)
ZERO, ONE, TWO, THREE, FOUR = f4(0), f4(1), f4(2), f4(3), f4(4)
SIX, EIGHT = f4(6), f4(8)


@inlined
def basis(x, y, z):
    """The 15 basis functions of the degrees 1 to 3 at a unit direction."""
    xx, yy, zz = x * x, y * y, z * z
    return (
        -_Y1 * y,
        _Y1 * z,
        -_Y1 * x,
        _Y2A * x * y,
        -_Y2A * y * z,
        _Y2B * (TWO * zz - xx - yy),
        -_Y2A * x * z,
        _Y2C * (xx - yy),
        -_Y3A * y * (THREE * xx - yy),
        _Y3B * x * y * z,
        -_Y3C * y * (FOUR * zz - xx - yy),
        _Y3D * z * (TWO * zz - THREE * xx - THREE * yy),
        -_Y3C * x * (FOUR * zz - xx - yy),
        _Y3E * z * (xx - yy),
        -_Y3A * x * (xx - THREE * yy),
    )


@inlined
def basis_gradient(degree, x, y, z, d):
    """Sum over the basis functions of d[k] x their gradient in (x, y, z)."""
    gx, gy, gz = -_Y1 * d[2], -_Y1 * d[0], _Y1 * d[1]
    if degree > 1:
        gx += _Y2A * (y * d[3] - z * d[6]) - TWO * _Y2B * x * d[5] + TWO * _Y2C * x * d[7]
        gy += _Y2A * (x * d[3] - z * d[4]) - TWO * _Y2B * y * d[5] - TWO * _Y2C * y * d[7]
        gz += -_Y2A * (y * d[4] + x * d[6]) + FOUR * _Y2B * z * d[5]
        if degree > 2:
            xx, yy, zz = x * x, y * y, z * z
            xy, yz, xz = x * y, y * z, x * z
            gx += -SIX * _Y3A * xy * d[8] + _Y3B * yz * d[9] + TWO * _Y3C * xy * d[10]
            gx += -SIX * _Y3D * xz * d[11] - _Y3C * (FOUR * zz - THREE * xx - yy) * d[12]
            gx += TWO * _Y3E * xz * d[13] - THREE * _Y3A * (xx - yy) * d[14]
            gy += -THREE * _Y3A * (xx - yy) * d[8] + _Y3B * xz * d[9]
            gy += -_Y3C * (FOUR * zz - xx - THREE * yy) * d[10] - SIX * _Y3D * yz * d[11]
            gy += TWO * _Y3C * xy * d[12] - TWO * _Y3E * yz * d[13] + SIX * _Y3A * xy * d[14]
            gz += _Y3B * xy * d[9] - EIGHT * _Y3C * yz * d[10]
            gz += THREE * _Y3D * (TWO * zz - xx - yy) * d[11] - EIGHT * _Y3C * xz * d[12]
            gz += _Y3E * (xx - yy) * d[13]
    return gx, gy, gz


@inlined
def direction(camera, mean):
    """Unit direction camera -> mean, and 1 / distance."""
    x, y, z = mean[0] - camera[12], mean[1] - camera[13], mean[2] - camera[14]
    inverse = ONE / math.sqrt(x * x + y * y + z * z)
    return x * inverse, y * inverse, z * inverse, inverse


@inlined
def sh_color(degree, way, base, count, shN, sh):
    """What the bands above 0, of the Gaussians that have them, add to red, green, blue; sh [256] is
    scratch."""
    b = basis(way[0], way[1], way[2])
    store16(sh, 0, (*b, zeros()))
    for lane in range(count):
        red, green, blue = ZERO, ZERO, ZERO
        terms = (degree + 1) * (degree + 1) - 1 if base + lane < len(shN) else 0
        for k in range(terms):
            value = sh[lane * LANES + k]
            red += value * shN[base + lane, k, 0]
            green += value * shN[base + lane, k, 1]
            blue += value * shN[base + lane, k, 2]
        sh[lane * LANES] = red
        sh[lane * LANES + 1] = green
        sh[lane * LANES + 2] = blue
    sums = load16(sh, 0)
    return sums[0], sums[1], sums[2]


@inlined
def sh_backward(degree, base, count, color, way, shN, g_shN, sh):
    """Fill g_shN; returns the gradient in the unit direction. sh [2, 256] is scratch."""
    terms = (degree + 1) * (degree + 1) - 1
    values, pulls = sh[0], sh[1]
    b = basis(way[0], way[1], way[2])
    store16(values, 0, (*b, zeros()))
    o = zeros()
    rest = (o, o, o, o, o, o, o, o, o, o, o, o, o)
    store16(pulls, 0, (color[0], color[1], color[2], *rest))
    for lane in range(count):
        at = lane * LANES
        red, green, blue = pulls[at], pulls[at + 1], pulls[at + 2]
        if base + lane >= len(shN):
            pulls[at : at + LANES] = ZERO
            continue
        coefficients, out = shN[base + lane], g_shN[base + lane]
        for k in range(terms):
            value = values[at + k]
            out[k, 0] = value * red
            out[k, 1] = value * green
            out[k, 2] = value * blue
            pulls[at + k] = (
                red * coefficients[k, 0] + green * coefficients[k, 1] + blue * coefficients[k, 2]
            )
    return basis_gradient(degree, way[0], way[1], way[2], load16(pulls, 0))
