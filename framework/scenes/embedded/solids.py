"""Nearest hits and surface points of boxes, ellipsoids and cylinders, in numba, strict IEEE.

Only `+ - * /`, `sqrt`, `floor` and comparisons appear, so that the bits are the same everywhere.
Rays are `o + t d` with any length of `d`; a miss is `t = inf`. Formulas: quadratic equation for
the curved solids, the slab method for boxes (Kay & Kajiya 1986).
"""

import math
from typing import Any

import numpy as np
from numba import njit

from framework.scenes.embedded.arrays import AXES, BOX, CENTER, CYLINDER, HALF, REPEAT, SHAPE

# Not cached on disk: numba would not notice a change in one of the three kernel files, and what
# the kernels make is itself cached.
STRICT: dict[str, Any] = {"nogil": True, "fastmath": False, "error_model": "numpy"}
# `inline="always"` on the larger ones spares atomic reference counts of their array arguments.
INNER: dict[str, Any] = {**STRICT, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
NEAREST = 1e-6  # hits nearer than this (in units of d) are the surface the ray starts from


@njit(**INNER)
def _slab(o, d, h):
    """The interval of t in which a coordinate o + t d lies in [-h, h]."""
    if d == 0.0:
        return (-np.inf, np.inf) if -h <= o <= h else (np.inf, -np.inf)
    a, b = (-h - o) / d, (h - o) / d
    return (a, b) if a < b else (b, a)


@njit(**INNER)
def _box(o, d, h):
    enter, leave = _slab(o[0], d[0], h[0])
    a, b = _slab(o[1], d[1], h[1])
    enter, leave = max(enter, a), min(leave, b)
    a, b = _slab(o[2], d[2], h[2])
    enter, leave = max(enter, a), min(leave, b)
    if enter > leave or leave < NEAREST:
        return np.inf
    return enter if enter > NEAREST else leave


@njit(**INNER)
def _ellipsoid(o, d, h):
    ox, oy, oz = o[0] / h[0], o[1] / h[1], o[2] / h[2]
    dx, dy, dz = d[0] / h[0], d[1] / h[1], d[2] / h[2]
    a = dx * dx + dy * dy + dz * dz
    b = ox * dx + oy * dy + oz * dz
    disc = b * b - a * (ox * ox + oy * oy + oz * oz - 1.0)
    if disc < 0.0:
        return np.inf
    root = math.sqrt(disc)
    if (-b - root) / a > NEAREST:
        return (-b - root) / a
    return (-b + root) / a if (-b + root) / a > NEAREST else np.inf


@njit(**INNER)
def _cylinder(o, d, h):
    ox, oz, dx, dz = o[0] / h[0], o[2] / h[2], d[0] / h[0], d[2] / h[2]
    best = np.inf
    a = dx * dx + dz * dz
    b = ox * dx + oz * dz
    disc = b * b - a * (ox * ox + oz * oz - 1.0)
    if disc >= 0.0 and a > 0.0:
        root = math.sqrt(disc)
        for t in ((-b - root) / a, (-b + root) / a):
            if NEAREST < t < best and abs(o[1] + t * d[1]) <= h[1]:
                best = t
    if d[1] != 0.0:
        for t in ((-h[1] - o[1]) / d[1], (h[1] - o[1]) / d[1]):
            x, z = ox + t * dx, oz + t * dz
            if NEAREST < t < best and x * x + z * z <= 1.0:
                best = t
    return best


@njit(**INNER)
def _local(solids, p, x, y, z):
    """World direction to the local axes of solid `p`."""
    return (
        solids[p, AXES] * x + solids[p, AXES + 1] * y + solids[p, AXES + 2] * z,
        solids[p, AXES + 3] * x + solids[p, AXES + 4] * y + solids[p, AXES + 5] * z,
        solids[p, AXES + 6] * x + solids[p, AXES + 7] * y + solids[p, AXES + 8] * z,
    )


@njit(**INNER)
def _local_point(solids, p, x):
    a, b, c = solids[p, CENTER], solids[p, CENTER + 1], solids[p, CENTER + 2]
    return _local(solids, p, x[0] - a, x[1] - b, x[2] - c)


@njit(**INNER)
def _half(solids, p):
    return solids[p, HALF], solids[p, HALF + 1], solids[p, HALF + 2]


@njit(**INNER)
def hit(solids, p, o, d):
    """t of the nearest hit of the ray (o, d) with solid `p`, inf if it misses."""
    h = _half(solids, p)
    local_o, local_d = _local_point(solids, p, o), _local(solids, p, d[0], d[1], d[2])
    shape = solids[p, SHAPE]
    if shape == BOX:
        t = _box(local_o, local_d, h)
    elif shape == CYLINDER:
        t = _cylinder(local_o, local_d, h)
    else:
        t = _ellipsoid(local_o, local_d, h)
    return t


@njit(**INNER)
def _fit(c, h, repeat):
    """Texture coordinate of the local coordinate c in [-h, h]: [0, 1] over the face, or tiled."""
    return c / repeat if repeat > 0.0 else 0.5 * (c / h + 1.0)


@njit(**INNER)
def _box_surface(q, h, repeat):
    x, y, z = q[0] / h[0], q[1] / h[1], q[2] / h[2]
    if abs(x) >= abs(y) and abs(x) >= abs(z):
        n = (1.0 if x > 0.0 else -1.0, 0.0, 0.0)
        return n, _fit(q[2], h[2], repeat), _fit(q[1], h[1], repeat)
    if abs(y) >= abs(z):
        n = (0.0, 1.0 if y > 0.0 else -1.0, 0.0)
        return n, _fit(q[0], h[0], repeat), _fit(q[2], h[2], repeat)
    n = (0.0, 0.0, 1.0 if z > 0.0 else -1.0)
    return n, _fit(q[0], h[0], repeat), _fit(q[1], h[1], repeat)


@njit(**INNER)
def _cylinder_surface(q, h, repeat):
    x, z = q[0] / h[0], -q[2] / h[2]
    if abs(q[1]) / h[1] > x * x + z * z:
        n = (0.0, 1.0 if q[1] > 0.0 else -1.0, 0.0)
        return n, _fit(q[0], h[0], repeat), _fit(q[2], h[2], repeat)
    # a monotone function of the angle, -2 .. 2 with its seam at the back (no arc tangent needed)
    turn = x / (abs(x) + abs(z))
    if z < 0.0:
        turn = 2.0 - turn if x >= 0.0 else -2.0 - turn
    u = 1.57 * turn * h[0] / repeat if repeat > 0.0 else 0.5 * (turn + 1.0)
    return (q[0] / (h[0] * h[0]), 0.0, q[2] / (h[2] * h[2])), u, _fit(q[1], h[1], repeat)


@njit(**INNER)
def surface(solids, p, x):
    """Outward unit normal (world) and texture coordinates of solid `p` at the world point x."""
    h, q = _half(solids, p), _local_point(solids, p, x)
    shape, repeat = solids[p, SHAPE], solids[p, REPEAT]
    if shape == BOX:
        n, u, v = _box_surface(q, h, repeat)
    elif shape == CYLINDER:
        n, u, v = _cylinder_surface(q, h, repeat)
    else:
        n = (q[0] / (h[0] * h[0]), q[1] / (h[1] * h[1]), q[2] / (h[2] * h[2]))
        u, v = _fit(q[0], h[0], repeat), _fit(q[1], h[1], repeat)
    length = math.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
    a, b, c = n[0] / length, n[1] / length, n[2] / length
    normal = (
        solids[p, AXES] * a + solids[p, AXES + 3] * b + solids[p, AXES + 6] * c,
        solids[p, AXES + 1] * a + solids[p, AXES + 4] * b + solids[p, AXES + 7] * c,
        solids[p, AXES + 2] * a + solids[p, AXES + 5] * b + solids[p, AXES + 8] * c,
    )
    return normal, u, v
