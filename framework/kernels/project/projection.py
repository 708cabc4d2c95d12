"""Projection of Gaussians to the screen: a kernel over blocks of Gaussians, 16 at a time.

`backward` has the gradient, `ewa` and `harmonics` the mathematics, and `ewa` the camera row.

A projected Gaussian is one row of 16 floats (a cache line). A, B, C is the conic, the inverse of
the 2D covariance.

    0-1    mean u, v, in pixels
    2-4    -A/2, -B, -C/2 times log2(e)
    5      log2(opacity)
    6-8    colour
    9      depth
    10-11  half-sides of the box that contains all alpha >= 1/255, in pixels
    12     opacity
    13-14  2^(2 row[4]) and the longest run of rows, see `tiles.first_alphas`
    15     B / C

The blending kernels compute alpha = 2^(row[5] + row[2] dx^2 + row[3] dx dy + row[4] dy^2).
"""

import math

import numpy as np

from framework.compute.chunks import put1, put_row, span, take1, take2, take3, take4
from framework.compute.jit import inlined, kernel
from framework.compute.simd import (
    LANES,
    absolute,
    any_lane,
    both,
    ceil,
    exp2,
    floor,
    greater,
    greater_equal,
    log2,
    maximum,
    minimum,
    select,
    splat,
    store_whole,
    zeros,
)
from framework.kernels.constants import ALPHA_MIN, FRUSTUM_MARGIN
from framework.kernels.project.ewa import (
    LOG2E,
    covariance,
    exp,
    rotation,
    screen_axes,
    times_rotation,
    to_camera,
    unit_quat,
)
from framework.kernels.project.harmonics import Y0, direction, sh_color
from framework.kernels.tile.tiles import longest_run

f4 = np.float32
ZERO, HALF, ONE, TWO, FOUR = f4(0), f4(0.5), f4(1), f4(2), f4(4)
_CUT = f4(ALPHA_MIN)
_REACH = f4(0.5 + FRUSTUM_MARGIN)
_HUGE = f4(1e30)
_TWO_LN2, _LOG2_255 = f4(2 * math.log(2)), f4(math.log2(255))
_TILE = f4(1 / 16)


@inlined
def _covered(u, v, rx, ry, w, h):
    """Whether the box u +- rx, v +- ry holds a pixel centre of the image, and how many tiles it
    covers."""
    left = maximum(ceil(u - rx - HALF), zeros())
    right = minimum(floor(u + rx - HALF), splat(w - ONE))
    top = maximum(ceil(v - ry - HALF), zeros())
    bottom = minimum(floor(v + ry - HALF), splat(h - ONE))
    columns = floor(right * _TILE) - floor(left * _TILE) + ONE
    bands = floor(bottom * _TILE) - floor(top * _TILE) + ONE
    return both(greater_equal(right, left), greater_equal(bottom, top)), columns * bands


@inlined
def _colour(degree, camera, mean, base, count, sh0, shN, sh, scratch):
    """As seen from the camera, not clamped."""
    first = take3(sh0, base, count, scratch)
    red, green, blue = HALF + Y0 * first[0], HALF + Y0 * first[1], HALF + Y0 * first[2]
    if degree > 0 and base < len(shN):
        more = sh_color(degree, direction(camera, mean), base, count, shN, sh)
        red, green, blue = red + more[0], green + more[1], blue + more[2]
    return red, green, blue


@inlined
def _clamped(red, green, blue):
    """Bit c (as a number) is set where colour c is below 0."""
    flag = select(greater(zeros(), red), splat(ONE), zeros())
    flag = flag + select(greater(zeros(), green), splat(TWO), zeros())
    return flag + select(greater(zeros(), blue), splat(FOUR), zeros())


@inlined
def _centre(camera, x, y, z, w, h):
    """(u, v) of the mean, and whether it lies beyond the near plane and not far off the image."""
    inverse_z = ONE / z
    u = camera[15] * x * inverse_z + camera[17]
    v = camera[16] * y * inverse_z + camera[18]
    across = greater_equal(splat(_REACH * w), absolute(u - HALF * w))
    down = greater_equal(splat(_REACH * h), absolute(v - HALF * h))
    return u, v, both(greater_equal(z, splat(camera[19])), both(across, down))


@inlined
def _spread(camera, x, y, z, quat, log_scale):
    """(xx, xy, yy, determinant) of the covariance on the screen."""
    qw, qx, qy, qz, _ = unit_quat(quat)
    m = times_rotation(screen_axes(camera, x, y, z), rotation(qw, qx, qy, qz))
    s0, s1, s2 = exp(log_scale[0]), exp(log_scale[1]), exp(log_scale[2])
    return covariance(m, s0, s1, s2, camera[20])


@inlined
def _row(centre, spread, colour, z, reach, opacity):
    """The 16 values that the tiles and the gradients read; see `binning` and `tiles.seen_from`."""
    xx, xy, yy, determinant = spread
    inverse = ONE / determinant
    power = (-HALF * LOG2E * yy * inverse, LOG2E * xy * inverse, -HALF * LOG2E * xx * inverse)
    o = zeros()
    seen = (maximum(colour[0], o), maximum(colour[1], o), maximum(colour[2], o), z)
    peak = log2(opacity)
    chain = (exp2(power[2] + power[2]), longest_run(power[2], peak), -xy / xx)
    return (*centre, *power, peak, *seen, *reach, opacity, *chain)


@inlined
def _put_numbers(target, base, count, values, whole):
    """Write the first `count` lanes into an array of whole numbers. whole: scratch of its type."""
    store_whole(whole, 0, values)
    for lane in range(count):
        target[base + lane] = whole[lane]


@kernel
def project(block, blocks, gaussians, degree, camera, size, out):
    """Project the Gaussians (`Arrays.flat`) to an image of size (width, height).

    Args:
        out: rows (flat [N 16]); clipped [N] uint8, where bit c is set if colour c was clamped at 0;
            bound [N] int32, the number of tiles that the box covers (0 = culled); radii [N]
            float32, the larger half-side of the box, 0 if culled.
    """
    means, quats, log_scales, logits, sh0, shN, factors, offset = gaussians
    rows, clipped, bound, radii = out
    n = len(logits)
    scratch, sh = np.empty(4 * LANES, np.float32), np.zeros(256, np.float32)
    w, h = f4(size[0]), f4(size[1])
    whole, flags = np.empty(LANES, np.int32), np.empty(LANES, np.uint8)
    start, end = span(n, block, blocks)
    for base in range(start, end, LANES):
        count = min(LANES, end - base)
        mean = take3(means, base, count, scratch)
        x, y, z = to_camera(camera, mean)
        logit = take1(logits, base, count, scratch)
        opacity = take1(factors, base, count, scratch) / (ONE + exp(-logit))
        u, v, near = _centre(camera, x, y, z, w, h)
        visible = both(near, greater_equal(opacity, splat(_CUT)))
        if not any_lane(visible):
            bound[base : base + count] = 0
            radii[base : base + count] = ZERO
            continue
        shift = take2(offset, base, count, scratch)
        u, v = u + shift[0], v + shift[1]
        quat = take4(quats, base, count, scratch)
        log_scale = take3(log_scales, base, count, scratch)
        spread = _spread(camera, x, y, z, quat, log_scale)
        # false also where parameters are not finite
        visible = both(visible, greater(spread[3], zeros()))
        visible = both(visible, greater(splat(_HUGE), spread[3]))
        colour = _colour(degree, camera, mean, base, count, sh0, shN, sh, scratch)
        reach = _TWO_LN2 * (log2(opacity) + _LOG2_255)
        rx, ry = math.sqrt(reach * spread[0]), math.sqrt(reach * spread[2])
        on_screen, covered = _covered(u, v, rx, ry, w, h)
        visible = both(visible, on_screen)
        put1(radii, base, count, scratch, select(visible, maximum(rx, ry), zeros()))
        put_row(rows, base, count, sh, _row((u, v), spread, colour, z, (rx, ry), opacity))
        _put_numbers(bound, base, count, select(visible, covered, zeros()), whole)
        _put_numbers(clipped, base, count, _clamped(colour[0], colour[1], colour[2]), flags)
