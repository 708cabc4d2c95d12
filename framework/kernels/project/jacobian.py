"""Derivatives of a Gaussian's alpha in its parameters, as polynomials on the screen.

At the offset (dx, dy) of a pixel from the projected mean, d(alpha)/d(parameter) / alpha is a
polynomial in dx and dy. The conic is [[A, B], [B, C]], y = conic (dx, dy), and J W is the
projection of the camera. With the columns r_k of the rotation, m_k = J W r_k and S' = sum_k s_k^2
m_k m_k^T (+ dilation):

    d(alpha) / alpha = y . d(u, v) + y^T dS' y / 2
    y^T dS' y / 2 = sum_k s_k (y . m_k) (y . d(s_k m_k))

So every coefficient is a product of two linear forms. They are expressed in dx and e = dy + (B / C)
dx, in which the conic is diagonal, diag(1 / S'_xx, C), and y = (dx / S'_xx + B e, C e). In dx and
dy, the sums of a long thin Gaussian would cancel. The monomials are m = (dx, e, dx^2, dx e, e^2).
Lanes are Gaussians.
"""

import numpy as np

from framework.compute.jit import inlined
from framework.compute.simd import LANES, store, zeros
from framework.kernels.project.ewa import exp, rotation, to_camera, unit_quat

TWO = np.float32(2)
PARAMETERS = 10  # mean 3, log-scale 3, quat 4
_ROW = PARAMETERS * LANES


@inlined
def _put(jacobian, at, a, b):
    """The coefficients of dx^2, dx e, e^2 in (a . (dx, e)) (b . (dx, e)), at rows 2 to 4."""
    store(jacobian, 2 * _ROW + at * LANES, a[0] * b[0])
    store(jacobian, 3 * _ROW + at * LANES, a[0] * b[1] + a[1] * b[0])
    store(jacobian, 4 * _ROW + at * LANES, a[1] * b[1])


@inlined
def _put_turned(jacobian, row, camera, x, y, z):
    """Coefficients by the camera-space mean -> by the mean."""
    at = row * _ROW
    store(jacobian, at, camera[0] * x + camera[3] * y + camera[6] * z)
    store(jacobian, at + LANES, camera[1] * x + camera[4] * y + camera[7] * z)
    store(jacobian, at + 2 * LANES, camera[2] * x + camera[5] * y + camera[8] * z)


@inlined
def _axis(camera, x, y, z, j):
    """For one axis r of the Gaussian: the two numbers of m = J W r, then the three of W r."""
    px = camera[0] * x + camera[1] * y + camera[2] * z
    py = camera[3] * x + camera[4] * y + camera[5] * z
    pz = camera[6] * x + camera[7] * y + camera[8] * z
    return j[0] * px + j[1] * pz, j[2] * py + j[3] * pz, px, py, pz


@inlined
def _form(m, spread, cb, cc):
    """y . m in dx and e; spread: 1 / S'_xx."""
    return spread * m[0], cb * m[0] + cc * m[1]


@inlined
def _scaled(s, n):
    return s * n[0], s * n[1]


@inlined
def _combined(a, b, c, k0, k1, k2):
    """a k0 + b k1 + c k2, 2-vectors."""
    return a * k0[0] + b * k1[0] + c * k2[0], a * k0[1] + b * k1[1] + c * k2[1]


@inlined
def _put_turns(jacobian, quat, n, s):
    """Write the coefficients of the quaternion.

    A turn w about the Gaussian's axis 0 mixes axes 1 and 2 by (s_1^2 - s_2^2) (y.m_1) (y.m_2), and
    so on; w = 2 vec(q* dq) / |q|.
    """
    qw, qx, qy, qz, scale = quat
    scale = TWO * scale
    t0, t1, t2 = scale * (s[1] - s[2]), scale * (s[2] - s[0]), scale * (s[0] - s[1])
    n0, n1, n2 = n
    for row in range(2, 5):
        if row == 2:
            a, b, c = n1[0] * n2[0], n2[0] * n0[0], n0[0] * n1[0]
        elif row == 3:
            a = n1[0] * n2[1] + n1[1] * n2[0]
            b = n2[0] * n0[1] + n2[1] * n0[0]
            c = n0[0] * n1[1] + n0[1] * n1[0]
        else:
            a, b, c = n1[1] * n2[1], n2[1] * n0[1], n0[1] * n1[1]
        wx, wy, wz = t0 * a, t1 * b, t2 * c
        at = row * _ROW + 6 * LANES
        store(jacobian, at, -qx * wx - qy * wy - qz * wz)
        store(jacobian, at + LANES, qw * wx - qz * wy + qy * wz)
        store(jacobian, at + 2 * LANES, qz * wx + qw * wy - qx * wz)
        store(jacobian, at + 3 * LANES, -qy * wx + qx * wy + qw * wz)


@inlined
def screen_jacobian(camera, mean, quaternion, log_scale, conic, jacobian):
    """Fill jacobian (flat [5, 10, 16]): coefficients of m by mean 3, log-scale 3, quat 4 of sixteen
    Gaussians. Rows 0 and 1 are 0 from parameter 3 on and not written there."""
    x, y, z = to_camera(camera, mean)
    quat = unit_quat(quaternion)
    r = rotation(quat[0], quat[1], quat[2], quat[3])
    _, cb, cc = conic
    inverse = np.float32(1) / z
    fx, fy = camera[15] * inverse, camera[16] * inverse
    gx, gy = -fx * x * inverse, -fy * y * inverse
    j = (fx, gx, fy, gy)
    m0 = _axis(camera, r[0], r[3], r[6], j)
    m1 = _axis(camera, r[1], r[4], r[7], j)
    m2 = _axis(camera, r[2], r[5], r[8], j)
    s = (exp(TWO * log_scale[0]), exp(TWO * log_scale[1]), exp(TWO * log_scale[2]))
    variance = s[0] * m0[0] * m0[0] + s[1] * m1[0] * m1[0] + s[2] * m2[0] * m2[0]
    spread = np.float32(1) / (variance + camera[20])
    n0, n1, n2 = _form(m0, spread, cb, cc), _form(m1, spread, cb, cc), _form(m2, spread, cb, cc)
    k0, k1, k2 = _scaled(s[0], n0), _scaled(s[1], n1), _scaled(s[2], n2)
    _put(jacobian, 3, k0, n0)
    _put(jacobian, 4, k1, n1)
    _put(jacobian, 5, k2, n2)
    _put_turns(jacobian, quat, (n0, n1, n2), s)
    # b_i = sum_k (W r_k)_i s_k^2 (y . m_k), in dx and e: what the entries of J that act on axis i
    # multiply
    b0x, b0y = _combined(m0[2], m1[2], m2[2], k0, k1, k2)
    b1x, b1y = _combined(m0[3], m1[3], m2[3], k0, k1, k2)
    b2x, b2y = _combined(m0[4], m1[4], m2[4], k0, k1, k2)
    px, py = -fx * inverse * b2x, -fx * inverse * b2y
    qx, qy = -fy * inverse * b2x, -fy * inverse * b2y
    ux, uy = inverse * (-fx * b0x - TWO * gx * b2x), inverse * (-fx * b0y - TWO * gx * b2y)
    vx, vy = inverse * (-fy * b1x - TWO * gy * b2x), inverse * (-fy * b1y - TWO * gy * b2y)
    none = zeros()
    _put_turned(jacobian, 0, camera, spread * fx, none, spread * gx)
    _put_turned(jacobian, 1, camera, cb * fx, cc * fy, cb * gx + cc * gy)
    _put_turned(jacobian, 2, camera, spread * px, none, spread * ux)
    _put_turned(
        jacobian,
        3,
        camera,
        spread * py + cb * px,
        cc * qx,
        spread * uy + cb * ux + cc * vx,
    )
    _put_turned(jacobian, 4, camera, cb * py, cc * qy, cb * uy + cc * vy)
