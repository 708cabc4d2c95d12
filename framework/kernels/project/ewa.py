"""One Gaussian's way to the screen and back: EWA splatting (Zwicker et al. 2001) as in 3DGS.

Helpers for float32 numbers and for vectors of them (`simd`) alike.

Camera row (float32[21]): rotation (9), translation (3), centre (3), fx, fy, cx, cy, near, dilation.
"""

import math

import numpy as np

from framework.compute.jit import inlined
from framework.compute.simd import exp2, minimum, splat

f4 = np.float32
HALF, ONE, TWO = f4(0.5), f4(1), f4(2)
LOG2E, LN2 = f4(1.4426950408889634), f4(0.6931471805599453)
_LARGEST = f4(126)


@inlined
def to_camera(camera, mean):
    x = camera[0] * mean[0] + camera[1] * mean[1] + camera[2] * mean[2] + camera[9]
    y = camera[3] * mean[0] + camera[4] * mean[1] + camera[5] * mean[2] + camera[10]
    z = camera[6] * mean[0] + camera[7] * mean[1] + camera[8] * mean[2] + camera[11]
    return x, y, z


@inlined
def unit_quat(quat):
    """(w, x, y, z) normalised, and 1 / norm."""
    w, x, y, z = quat[0], quat[1], quat[2], quat[3]
    inverse = ONE / math.sqrt(w * w + x * x + y * y + z * z)
    return w * inverse, x * inverse, y * inverse, z * inverse, inverse


@inlined
def rotation(w, x, y, z):
    """Row-major rotation matrix of a unit quaternion."""
    return (
        ONE - TWO * (y * y + z * z),
        TWO * (x * y - w * z),
        TWO * (x * z + w * y),
        TWO * (x * y + w * z),
        ONE - TWO * (x * x + z * z),
        TWO * (y * z - w * x),
        TWO * (x * z - w * y),
        TWO * (y * z + w * x),
        ONE - TWO * (x * x + y * y),
    )


@inlined
def screen_axes(camera, x, y, z):
    """T = J W, 2x3 row-major: how the projected point moves with the world point."""
    inverse = ONE / z
    jx, jy = camera[15] * inverse, camera[16] * inverse
    kx, ky = -jx * x * inverse, -jy * y * inverse
    return (
        jx * camera[0] + kx * camera[6],
        jx * camera[1] + kx * camera[7],
        jx * camera[2] + kx * camera[8],
        jy * camera[3] + ky * camera[6],
        jy * camera[4] + ky * camera[7],
        jy * camera[5] + ky * camera[8],
    )


@inlined
def times_rotation(t, r):
    """U = T R, 2x3."""
    return (
        t[0] * r[0] + t[1] * r[3] + t[2] * r[6],
        t[0] * r[1] + t[1] * r[4] + t[2] * r[7],
        t[0] * r[2] + t[1] * r[5] + t[2] * r[8],
        t[3] * r[0] + t[4] * r[3] + t[5] * r[6],
        t[3] * r[1] + t[4] * r[4] + t[5] * r[7],
        t[3] * r[2] + t[4] * r[5] + t[5] * r[8],
    )


@inlined
def exp(x):
    """exp(x) of a vector; 2^126 where the result would exceed it or x is not a number."""
    return exp2(minimum(x * LOG2E, splat(_LARGEST)))


@inlined
def covariance(m, s0, s1, s2, dilation):
    """xx, xy, yy of U S S^T U^T + dilation for U = `m` [2x3], and their determinant."""
    a0, a1, a2 = m[0] * s0, m[1] * s1, m[2] * s2
    b0, b1, b2 = m[3] * s0, m[4] * s1, m[5] * s2
    xx = a0 * a0 + a1 * a1 + a2 * a2
    xy = a0 * b0 + a1 * b1 + a2 * b2
    yy = b0 * b0 + b1 * b1 + b2 * b2
    # xx yy - xy^2 would cancel for long, thin Gaussians and leave an indefinite conic
    c01, c02, c12 = a0 * b1 - a1 * b0, a0 * b2 - a2 * b0, a1 * b2 - a2 * b1
    determinant = c01 * c01 + c02 * c02 + c12 * c12 + dilation * (xx + yy + dilation)
    return xx + dilation, xy, yy + dilation, determinant


@inlined
def conic_of(row):
    """A, B, C, the inverse of the 2D covariance, from a projected Gaussian; see `projection`."""
    return -TWO * LN2 * row[2], -LN2 * row[3], -TWO * LN2 * row[4]


@inlined
def _from_conic(conic, ga, gb, gc, m, scales):
    """Compute d loss / d U [2x3] and the gradient in the log-scales from that in A, B, C.

    The chain is conic -> covariance (dS = -C G C) -> A = U S.
    """
    ca, cb, cc = conic
    gh = HALF * gb
    h00, h01 = ca * ga + cb * gh, ca * gh + cb * gc
    h10, h11 = cb * ga + cc * gh, cb * gh + cc * gc
    p00, p01, p11 = -(h00 * ca + h01 * cb), -(h00 * cb + h01 * cc), -(h10 * cb + h11 * cc)
    s0, s1, s2 = scales
    d00, d10 = TWO * (p00 * m[0] + p01 * m[3]) * s0, TWO * (p01 * m[0] + p11 * m[3]) * s0
    d01, d11 = TWO * (p00 * m[1] + p01 * m[4]) * s1, TWO * (p01 * m[1] + p11 * m[4]) * s1
    d02, d12 = TWO * (p00 * m[2] + p01 * m[5]) * s2, TWO * (p01 * m[2] + p11 * m[5]) * s2
    # so far d(loss)/d(A); log-scale gradient = A . dA, dU = dA S
    l0 = s0 * (d00 * m[0] + d10 * m[3])
    l1 = s1 * (d01 * m[1] + d11 * m[4])
    l2 = s2 * (d02 * m[2] + d12 * m[5])
    return (d00 * s0, d01 * s1, d02 * s2, d10 * s0, d11 * s1, d12 * s2), (l0, l1, l2)


@inlined
def _to_quat(t, d, quat):
    """Gradient in the stored quaternion from d = d loss / d U, U = T R, through its norm."""
    e0, e1, e2 = t[0] * d[0] + t[3] * d[3], t[0] * d[1] + t[3] * d[4], t[0] * d[2] + t[3] * d[5]
    e3, e4, e5 = t[1] * d[0] + t[4] * d[3], t[1] * d[1] + t[4] * d[4], t[1] * d[2] + t[4] * d[5]
    e6, e7, e8 = t[2] * d[0] + t[5] * d[3], t[2] * d[1] + t[5] * d[4], t[2] * d[2] + t[5] * d[5]
    qw, qx, qy, qz, qi = quat
    kw = TWO * (qx * (e7 - e5) + qy * (e2 - e6) + qz * (e3 - e1))
    kx = TWO * (-TWO * qx * (e4 + e8) + qy * (e1 + e3) + qz * (e2 + e6) + qw * (e7 - e5))
    ky = TWO * (qx * (e1 + e3) - TWO * qy * (e0 + e8) + qz * (e5 + e7) + qw * (e2 - e6))
    kz = TWO * (qx * (e2 + e6) + qy * (e5 + e7) - TWO * qz * (e0 + e4) + qw * (e3 - e1))
    along = kw * qw + kx * qx + ky * qy + kz * qz
    return (
        (kw - along * qw) * qi,
        (kx - along * qx) * qi,
        (ky - along * qy) * qi,
        (kz - along * qz) * qi,
    )


@inlined
def _to_mean(camera, x, y, z, r, d, gu, gv, gz):
    """Gradient in the mean from those in (u, v, z) and d = d loss / d U, U = J W R."""
    t0 = d[0] * r[0] + d[1] * r[1] + d[2] * r[2]
    t1 = d[0] * r[3] + d[1] * r[4] + d[2] * r[5]
    t2 = d[0] * r[6] + d[1] * r[7] + d[2] * r[8]
    t3 = d[3] * r[0] + d[4] * r[1] + d[5] * r[2]
    t4 = d[3] * r[3] + d[4] * r[4] + d[5] * r[5]
    t5 = d[3] * r[6] + d[4] * r[7] + d[5] * r[8]
    # dJ = dT W^T, only its four entries that depend on the mean
    j00 = t0 * camera[0] + t1 * camera[1] + t2 * camera[2]
    j02 = t0 * camera[6] + t1 * camera[7] + t2 * camera[8]
    j11 = t3 * camera[3] + t4 * camera[4] + t5 * camera[5]
    j12 = t3 * camera[6] + t4 * camera[7] + t5 * camera[8]
    inverse = ONE / z
    fx, fy = camera[15] * inverse, camera[16] * inverse
    gx = fx * (gu - j02 * inverse)
    gy = fy * (gv - j12 * inverse)
    gz -= inverse * (fx * (x * gu + j00) + fy * (y * gv + j11))
    gz += TWO * inverse * inverse * (fx * x * j02 + fy * y * j12)
    return (
        camera[0] * gx + camera[3] * gy + camera[6] * gz,
        camera[1] * gx + camera[4] * gy + camera[7] * gz,
        camera[2] * gx + camera[5] * gy + camera[8] * gz,
    )


@inlined
def pull_back(camera, x, y, z, t, r, m, scales, quat, conic, gu, gv, ga, gb, gc, gz):
    """Gradients in (mean 3, log-scale 3, quat 4) from those in (u, v, A, B, C, z)."""
    d, g_scales = _from_conic(conic, ga, gb, gc, m, scales)
    g_mean = _to_mean(camera, x, y, z, r, d, gu, gv, gz)
    return g_mean + g_scales + _to_quat(t, d, quat)
