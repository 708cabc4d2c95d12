"""Light that leaves a surface: Lambert + Blinn-Phong highlight under a soft key light and a fill.

Colours are linear with gamma 2 (stored value = sqrt), so that no power function is needed. Each
subsample of a pixel uses another of the L directions of the key light: their mean is a soft shadow,
and the same in every view. Formulas: Blinn 1977.
"""

import math

import numpy as np
from numba import njit

from framework.scenes.embedded.arrays import (
    ACROSS,
    CONTRAST,
    GLOW,
    GRID,
    HIGHLIGHT,
    MEAN,
    TEXTURE,
    TINT,
    TOWARDS,
)
from framework.scenes.embedded.solids import INNER, hit, surface

KEY = (1.02, 0.96, 0.86)  # radiance of the key light, warm
FILL = (0.34, 0.37, 0.42)  # of the ambient light, cool
LIFT = 1e-4  # secondary rays start this far off the surface


@njit(**INNER)
def dot(a, b):
    """Inner product of two triples."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(**INNER)
def _mirrored(t):
    """t folded into [0, 1]: tiles that mirror each other have no seams."""
    t = t - 2.0 * math.floor(0.5 * t)
    return 2.0 - t if t > 1.0 else t


@njit(**INNER)
def _texture(texels, start, height, width, u, v):
    """Bilinear lookup, linear RGB."""
    x, y = _mirrored(u) * (width - 1), _mirrored(v) * (height - 1)
    column, row = min(int(x), width - 2), min(int(y), height - 2)
    fx, fy = x - column, y - row
    i = start + 3 * (row * width + column)
    red, green, blue = 0.0, 0.0, 0.0
    for corner in range(4):
        weight = (fx if corner & 1 else 1.0 - fx) * (fy if corner & 2 else 1.0 - fy) / 65025.0
        j = i + (3 if corner & 1 else 0) + (3 * width if corner & 2 else 0)
        r, g, b = float(texels[j]), float(texels[j + 1]), float(texels[j + 2])
        red, green, blue = red + weight * r * r, green + weight * g * g, blue + weight * b * b
    return red, green, blue


@njit(**INNER)
def _contrasted(solids, p, channel, value):
    mean = solids[p, MEAN + channel]
    return max(0.0, mean + solids[p, CONTRAST] * (value - mean))


@njit(inline="always", **INNER)
def _albedo(solids, texels, p, u, v):
    r, g, b = solids[p, TINT], solids[p, TINT + 1], solids[p, TINT + 2]
    start = int(solids[p, TEXTURE])
    if start >= 0:
        height, width = int(solids[p, TEXTURE + 1]), int(solids[p, TEXTURE + 2])
        x, y, z = _texture(texels, start, height, width, u, v)
        r = r * _contrasted(solids, p, 0, x)
        g = g * _contrasted(solids, p, 1, y)
        b = b * _contrasted(solids, p, 2, z)
    return r, g, b


@njit(**INNER)
def _cell(lights, light, k, x):
    """Index of the light cell of x along axis k across the rays."""
    i = ACROSS + 3 * k
    along = lights[light, i] * x[0] + lights[light, i + 1] * x[1] + lights[light, i + 2] * x[2]
    return math.floor((along - lights[light, GRID + k]) / lights[light, GRID + 2])


@njit(inline="always", **INNER)
def _lit(solids, lights, casters, light, towards, x):
    """False where a caster stands between the point and the light, in direction `towards`."""
    a, b = _cell(lights, light, 0, x), _cell(lights, light, 1, x)
    size, k, lit = casters.shape[1], 0, True
    if 0 <= a < size and 0 <= b < size:
        while lit and casters[light, a, b, k] >= 0:
            lit = not hit(solids, np.int64(casters[light, a, b, k]), x, towards) < np.inf
            k += 1
    return lit


@njit(**INNER)
def _lobe(n, towards, d):
    """Blinn-Phong: the 32nd power of the cosine between normal and half vector."""
    h = (towards[0] - d[0], towards[1] - d[1], towards[2] - d[2])
    c = max(0.0, dot(n, h)) / math.sqrt(dot(h, h))
    for _ in range(5):
        c = c * c
    return c


@njit(**INNER)
def surroundings(d):
    """What lies behind the cameras, seen only in mirrors: a dim room with a four-pane window."""
    if d[2] < 0.0:
        x, y = d[0] / -d[2], d[1] / -d[2]
        ax, ay = abs(x + 0.9), abs(y + 0.75)
        if 0.05 < ax < 0.6 and 0.05 < ay < 0.55:
            return (2.6, 2.7, 2.8)
    up = 0.5 - 0.5 * d[1]
    return (0.10 + 0.16 * up, 0.11 + 0.15 * up, 0.12 + 0.14 * up)


@njit(inline="always", **INNER)
def shade(solids, texels, lights, casters, light, p, x, d):
    """Linear RGB that leaves solid `p` at point x against the unit direction d, without mirroring;
    the normal, turned towards the viewer; and x lifted off the surface along it."""
    n, u, v = surface(solids, p, x)
    if dot(n, d) > 0.0:
        n = (-n[0], -n[1], -n[2])
    start = (x[0] + LIFT * n[0], x[1] + LIFT * n[1], x[2] + LIFT * n[2])
    towards = (lights[light, TOWARDS], lights[light, TOWARDS + 1], lights[light, TOWARDS + 2])
    direct, highlight = max(0.0, dot(n, towards)), 0.0
    if direct > 0.0 and not _lit(solids, lights, casters, light, towards, start):
        direct = 0.0
    if direct > 0.0 and solids[p, HIGHLIGHT] > 0.0:
        highlight = solids[p, HIGHLIGHT] * _lobe(n, towards, d)
    a = _albedo(solids, texels, p, u, v)
    sky = 0.8 - 0.2 * n[1] + solids[p, GLOW]
    colour = (
        a[0] * (FILL[0] * sky + KEY[0] * direct) + KEY[0] * highlight,
        a[1] * (FILL[1] * sky + KEY[1] * direct) + KEY[1] * highlight,
        a[2] * (FILL[2] * sky + KEY[2] * direct) + KEY[2] * highlight,
    )
    return colour, n, start
