"""One view of the embedded scene: 8-bit image and exact depth, traced row by row.

Mirrors reflect once, with a rise towards grazing angles after Schlick 1994.
"""

import math

import numpy as np
from numba import njit

from framework.scenes.embedded.arrays import MIRROR
from framework.scenes.embedded.shade import dot, shade, surroundings
from framework.scenes.embedded.solids import INNER, STRICT, hit


@njit(inline="always", **INNER)
def _first(solids, members, tile, o, d):
    """The solid of a tile's list that the ray (o, d) meets first and its t; (-1, inf) if none."""
    best, nearest, k = np.inf, np.int64(-1), 0
    while members[tile, k] >= 0:
        p = np.int64(members[tile, k])
        t = hit(solids, p, o, d)
        if t < best:
            best, nearest = t, p
        k += 1
    return nearest, best


@njit(**INNER)
def _reflectance(mirror, n, d):
    """Schlick's approximation, its rise scaled by `mirror` so that 0 reflects nothing."""
    grazing = 1.0 + dot(n, d)
    square = grazing * grazing
    return mirror + (1.0 - mirror) * mirror * square * square * grazing


@njit(inline="always", **INNER)
def _radiance(solids, texels, lights, casters, members, light, o, d, p, t):
    """Linear RGB along the ray (o, d), which meets solid `p` (-1 = none) at t."""
    length = math.sqrt(dot(d, d))
    d, t = (d[0] / length, d[1] / length, d[2] / length), t * length
    red, green, blue, share = 0.0, 0.0, 0.0, 1.0
    for _ in range(2):
        if p < 0:
            c, mirror, n = surroundings(d), 0.0, d
        else:
            x = (o[0] + t * d[0], o[1] + t * d[1], o[2] + t * d[2])
            c, n, o = shade(solids, texels, lights, casters, light, p, x, d)
            mirror = _reflectance(solids[p, MIRROR], n, d)
        kept = share * (1.0 - mirror) if share == 1.0 else share
        red, green, blue = red + kept * c[0], green + kept * c[1], blue + kept * c[2]
        share = share - kept
        if not share > 0.0:
            break
        turn = 2.0 * dot(n, d)
        d = (d[0] - turn * n[0], d[1] - turn * n[1], d[2] - turn * n[2])
        p, t = _first(solids, members, members.shape[0] - 1, o, d)
    return red, green, blue


@njit(**INNER)
def _direction(pose, focal, width, height, x, y):
    """World direction of the ray through pixel position (x, y), with camera z = 1."""
    a, b = (x - 0.5 * width) / focal, (y - 0.5 * height) / focal
    return (
        pose[0, 0] * a + pose[0, 1] * b + pose[0, 2],
        pose[1, 0] * a + pose[1, 1] * b + pose[1, 2],
        pose[2, 0] * a + pose[2, 1] * b + pose[2, 2],
    )


@njit(**INNER)
def _stored(linear):
    return np.uint8(math.floor(255.0 * math.sqrt(min(1.0, max(0.0, linear))) + 0.5))


@njit(**STRICT)
def trace_rows(
    block,
    n_blocks,
    solids,
    texels,
    lights,
    casters,
    members,
    tile,
    pose,
    focal,
    samples,
    image,
    depth,
):
    """Every n_blocks-th row of a view.

    Args:
        tile: pixels.
        pose: [3, 4] float64 camera-to-world.
        focal: pixels. samples x samples rays per pixel.
        image: [H, W, 3] uint8 and depth: [H, W] float32 are written; as a ray's direction has
            camera z = 1, its t is the z-depth.
    """
    height, width = depth.shape
    n_tiles, n_samples = (width + tile - 1) // tile, samples * samples
    o = (pose[0, 3], pose[1, 3], pose[2, 3])
    for row in range(block, height, n_blocks):
        for column in range(width):
            member = (row // tile) * n_tiles + column // tile
            red, green, blue = 0.0, 0.0, 0.0
            for k in range(n_samples + 1):
                centre = k == n_samples
                x = 0.5 if centre else (k % samples + 0.5) / samples
                y = 0.5 if centre else (k // samples + 0.5) / samples
                d = _direction(pose, focal, width, height, column + x, row + y)
                p, t = _first(solids, members, member, o, d)
                if centre:
                    depth[row, column] = t if p >= 0 else 0.0
                else:
                    # neighbouring subsamples get light directions far from each other
                    light = (7 * k) % lights.shape[0]
                    r, g, b = _radiance(solids, texels, lights, casters, members, light, o, d, p, t)
                    red, green, blue = red + r, green + g, blue + b
            image[row, column, 0] = _stored(red / n_samples)
            image[row, column, 1] = _stored(green / n_samples)
            image[row, column, 2] = _stored(blue / n_samples)
