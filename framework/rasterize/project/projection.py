"""Gaussians -> screen, and the gradient back: kernels over blocks of Gaussians, 16 at a time.

A projected Gaussian is one row of 16 floats (a cache line): 0-1 mean u, v [px]; 2-4 -A/2, -B, -C/2
times log2(e); 5 log2(opacity); 6-8 colour; 9 depth; 10-11 half-sides of the box that holds all
alpha >= 1/255 [px]; 12 opacity; 13 2^(2 row[4]) and 14 the longest run of rows, see
`tiles.first_alphas`; 15 B / C. A, B, C is the conic, the inverse of the 2D covariance.
With it the blending kernels get alpha = 2^(row[5] + row[2] dx^2 + row[3] dx dy + row[4] dy^2).

The mathematics is in `ewa` and `harmonics`, the camera row in `ewa`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from framework.compute.chunks import put1, put2, put3, put4, span, take1, take2, take3, take4
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
    load,
    load16,
    log2,
    maximum,
    minimum,
    select,
    splat,
    store,
    store16,
    store_whole,
    zeros,
)
from framework.rasterize.constants import ALPHA_MIN, FRUSTUM_MARGIN
from framework.rasterize.project.ewa import (
    LOG2E,
    conic_of,
    covariance,
    exp,
    pull_back,
    rotation,
    screen_axes,
    times_rotation,
    to_camera,
    unit_quat,
)
from framework.rasterize.project.harmonics import Y0, direction, sh_backward, sh_color
from framework.rasterize.tile.tiles import longest_run

f4 = np.float32
ZERO, HALF, ONE, TWO, FOUR = f4(0), f4(0.5), f4(1), f4(2), f4(4)
_CUT = f4(ALPHA_MIN)
_REACH = f4(0.5 + FRUSTUM_MARGIN)
_HUGE = f4(1e30)
_TWO_LN2, _LOG2_255 = f4(2 * math.log(2)), f4(math.log2(255))
_TILE = f4(1 / 16)


@inlined
def _covered(u: Any, v: Any, rx: Any, ry: Any, w: Any, h: Any) -> tuple[Any, Any]:
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
def _colour(
    degree: int,
    camera: Any,
    mean: Any,
    base: int,
    count: int,
    sh0: Any,
    shN: Any,
    sh: Any,
    scratch: Any,
) -> tuple[Any, Any, Any]:
    """As seen from the camera, not clamped."""
    first = take3(sh0, base, count, scratch)
    red, green, blue = HALF + Y0 * first[0], HALF + Y0 * first[1], HALF + Y0 * first[2]
    if degree > 0 and base < len(shN):
        more = sh_color(degree, direction(camera, mean), base, count, shN, sh)
        red, green, blue = red + more[0], green + more[1], blue + more[2]
    return red, green, blue


@inlined
def _clamped(red: Any, green: Any, blue: Any) -> Any:
    """Bit c (as a number) is set where colour c is below 0."""
    flag = select(greater(zeros(), red), splat(ONE), zeros())
    flag = flag + select(greater(zeros(), green), splat(TWO), zeros())
    return flag + select(greater(zeros(), blue), splat(FOUR), zeros())


@inlined
def _put_row(rows: Any, base: int, count: int, row: Any, spare: Any) -> None:
    """Store the rows of `count` Gaussians; spare: scratch [256]."""
    if count == LANES:
        store16(rows, base * LANES, row)
    else:
        store16(spare, 0, row)
        for i in range(count * LANES):
            rows[base * LANES + i] = spare[i]


@inlined
def _take_row(rows: Any, base: int, count: int, spare: Any) -> Any:
    """What `_put_row` stored; the lanes beyond are of no meaning."""
    if count == LANES:
        row = load16(rows, base * LANES)
    else:
        for i in range(count * LANES):
            spare[i] = rows[base * LANES + i]
        row = load16(spare, 0)
    return row


@inlined
def _centre(camera: Any, x: Any, y: Any, z: Any, w: Any, h: Any) -> tuple[Any, Any, Any]:
    """(u, v) of the mean, and whether it lies beyond the near plane and not far off the image."""
    inverse_z = ONE / z
    u = camera[15] * x * inverse_z + camera[17]
    v = camera[16] * y * inverse_z + camera[18]
    across = greater_equal(splat(_REACH * w), absolute(u - HALF * w))
    down = greater_equal(splat(_REACH * h), absolute(v - HALF * h))
    return u, v, both(greater_equal(z, splat(camera[19])), both(across, down))


@inlined
def _spread(camera: Any, x: Any, y: Any, z: Any, quat: Any, log_scale: Any) -> tuple[Any, ...]:
    """(xx, xy, yy, determinant) of the covariance on the screen."""
    qw, qx, qy, qz, _ = unit_quat(quat)
    m = times_rotation(screen_axes(camera, x, y, z), rotation(qw, qx, qy, qz))
    return covariance(m, exp(log_scale[0]), exp(log_scale[1]), exp(log_scale[2]))


@inlined
def _row(centre: Any, spread: Any, colour: Any, z: Any, reach: Any, opacity: Any) -> Any:
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
def _put_numbers(target: Any, base: int, count: int, values: Any, whole: Any) -> None:
    """Write the first `count` lanes into an array of whole numbers. whole: scratch of its type."""
    store_whole(whole, 0, values)
    for lane in range(count):
        target[base + lane] = whole[lane]


@kernel
def project(
    block: int,
    blocks: int,
    means: Any,
    quats: Any,
    log_scales: Any,
    logits: Any,
    sh0: Any,
    shN: Any,
    factors: Any,
    offset: Any,
    degree: int,
    camera: Any,
    width: int,
    height: int,
    rows: Any,
    clipped: Any,
    bound: Any,
    radii: Any,
) -> None:
    """Fill `rows` (flat [N 16]); clipped [N] uint8: bit c set where colour c was clamped at 0;
    bound [N] int32: the number of tiles the box covers (0 = culled), an upper bound on those
    touched; radii [N]: the larger half-side of the box, 0 if culled. All but shN [M, K, 3] flat."""
    n = len(logits)
    scratch, sh = np.empty(4 * LANES, np.float32), np.zeros(256, np.float32)
    w, h = f4(width), f4(height)
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
        _put_row(rows, base, count, _row((u, v), spread, colour, z, (rx, ry), opacity), sh)
        _put_numbers(bound, base, count, select(visible, covered, zeros()), whole)
        _put_numbers(clipped, base, count, _clamped(colour[0], colour[1], colour[2]), flags)


@inlined
def _sum_parts(first: Any, sums: Any, base: int, count: int, total: Any) -> int:
    """The sum of every Gaussian's parts, in their order, into total (flat [16 16]), row 15 of
    which counts them; returns the number of parts."""
    for lane in range(count):
        begin, end = first[base + lane], first[base + lane + 1]
        own = zeros()
        for j in range(begin, end):
            own = own + load(sums, j * LANES)
        store(total, lane * LANES, own)
        total[lane * LANES + 15] = f4(end - begin)
    return first[base + count] - first[base]


@inlined
def _only3(seen: Any, x: Any, y: Any, z: Any) -> tuple[Any, Any, Any]:
    """0 for the lanes that are not seen."""
    o = zeros()
    return select(seen, x, o), select(seen, y, o), select(seen, z, o)


@inlined
def _zero(gradients: Any, base: int, count: int) -> None:
    """No gradient for Gaussians base ... base + count - 1."""
    g_means, g_quats, g_log_scales, g_logits, g_sh0, g_shN, g_factors, g_offset = gradients
    g_means[3 * base : 3 * (base + count)] = ZERO
    g_quats[4 * base : 4 * (base + count)] = ZERO
    g_log_scales[3 * base : 3 * (base + count)] = ZERO
    g_logits[base : base + count] = ZERO
    g_sh0[3 * base : 3 * (base + count)] = ZERO
    g_shN[base : base + count] = ZERO
    g_factors[base : base + count] = ZERO
    g_offset[2 * base : 2 * (base + count)] = ZERO


@inlined
def _unclamped(
    seen: Any, clipped: Any, base: int, count: int, sums: Any, flags: Any
) -> tuple[Any, Any, Any]:
    """The gradient of the three colours, 0 where they were clamped. flags: scratch [3, 16]."""
    for lane in range(count):
        for c in range(3):
            flags[c, lane] = f4((clipped[base + lane] >> c) & 1)
    gr = select(both(seen, greater(splat(HALF), load(flags[0], 0))), sums[6], zeros())
    gg = select(both(seen, greater(splat(HALF), load(flags[1], 0))), sums[7], zeros())
    gb = select(both(seen, greater(splat(HALF), load(flags[2], 0))), sums[8], zeros())
    return gr, gg, gb


@inlined
def _through_direction(vx: Any, vy: Any, vz: Any, way: Any) -> tuple[Any, Any, Any]:
    """d / d mean from d / d direction; way: the unit direction and 1 / distance."""
    radial = vx * way[0] + vy * way[1] + vz * way[2]
    return (
        (vx - radial * way[0]) * way[3],
        (vy - radial * way[1]) * way[3],
        (vz - radial * way[2]) * way[3],
    )


@inlined
def _to_ellipse(sums: Any, conic: Any, seen: Any) -> tuple[Any, ...]:
    """Gradients in u, v, A, B, C from the sums of a = (d loss / d alpha) alpha, see
    `project_backward`: log(alpha) falls by (A dx^2 + 2 B dx dy + C dy^2) / 2 from the mean."""
    ca, cb, cc = conic
    gu = select(seen, ca * sums[1] + cb * sums[3], zeros())
    gv = select(seen, cb * sums[1] + cc * sums[3], zeros())
    return gu, gv, -HALF * sums[2], -sums[4], -HALF * sums[5]


@inlined
def _to_opacity(g_opacity: Any, logit: Any, factor: Any) -> tuple[Any, Any]:
    """Gradients in factor and logit of the opacity: factor x sigmoid(logit)."""
    opacity = ONE / (ONE + exp(-logit))
    return g_opacity * opacity, g_opacity * factor * opacity * (ONE - opacity)


@kernel
def project_backward(
    block: int,
    blocks: int,
    means: Any,
    quats: Any,
    log_scales: Any,
    logits: Any,
    shN: Any,
    factors: Any,
    degree: int,
    camera: Any,
    rows: Any,
    clipped: Any,
    first: Any,
    sums: Any,
    g_means: Any,
    g_quats: Any,
    g_log_scales: Any,
    g_logits: Any,
    g_sh0: Any,
    g_shN: Any,
    g_factors: Any,
    g_offset: Any,
) -> None:
    """Sum every Gaussian's parts in their order, then pull the sums back to the parameters.

    Lanes of a part: sums over pixels of a = (d loss / d alpha) alpha times 1, dx, dx^2, dy, dx dy,
    dy^2, then of weight times d loss / d (r, g, b, depth); see `blend.blend_backward`. All but shN
    and g_shN [M, K, 3] are flat.
    """
    n = len(logits)
    scratch, total = np.empty(4 * LANES, np.float32), np.zeros(256, np.float32)
    sh, flags = np.zeros((2, 256), np.float32), np.zeros((3, LANES), np.float32)
    gradients = (g_means, g_quats, g_log_scales, g_logits, g_sh0, g_shN, g_factors, g_offset)
    terms = (degree + 1) * (degree + 1) - 1
    start, end = span(n, block, blocks)
    for base in range(start, end, LANES):
        count = min(LANES, end - base)
        if _sum_parts(first, sums, base, count, total) == 0:
            _zero(gradients, base, count)
            continue
        s = load16(total, 0)
        row = _take_row(rows, base, count, total)
        seen = greater(s[15], zeros())
        conic = conic_of(row)
        gu, gv, ga, gb, gc = _to_ellipse(s, conic, seen)
        mean = take3(means, base, count, scratch)
        x, y, z = to_camera(camera, mean)
        t = screen_axes(camera, x, y, z)
        quat = unit_quat(take4(quats, base, count, scratch))
        r = rotation(quat[0], quat[1], quat[2], quat[3])
        m = times_rotation(t, r)
        log_scale = take3(log_scales, base, count, scratch)
        scales = (exp(log_scale[0]), exp(log_scale[1]), exp(log_scale[2]))
        g = pull_back(camera, x, y, z, t, r, m, scales, quat, conic, gu, gv, ga, gb, gc, s[9])
        gr, gg, gl = _unclamped(seen, clipped, base, count, s, flags)
        mx, my, mz = g[0], g[1], g[2]
        put3(g_sh0, base, count, scratch, (Y0 * gr, Y0 * gg, Y0 * gl))
        if degree > 0 and base < len(shN):
            way = direction(camera, mean)
            vx, vy, vz = sh_backward(degree, base, count, (gr, gg, gl), way, shN, g_shN, sh)
            px, py, pz = _through_direction(vx, vy, vz, way)
            mx, my, mz = mx + px, my + py, mz + pz
        g_shN[base : base + count, terms:, :] = ZERO
        put3(g_means, base, count, scratch, _only3(seen, mx, my, mz))
        put3(g_log_scales, base, count, scratch, _only3(seen, g[3], g[4], g[5]))
        turn = _only3(seen, g[7], g[8], g[9])
        put4(g_quats, base, count, scratch, (select(seen, g[6], zeros()), *turn))
        g_opacity = select(seen, s[0] / row[12], zeros())
        logit, factor = take1(logits, base, count, scratch), take1(factors, base, count, scratch)
        g_factor, g_logit = _to_opacity(g_opacity, logit, factor)
        put1(g_factors, base, count, scratch, g_factor)
        put1(g_logits, base, count, scratch, g_logit)
        put2(g_offset, base, count, scratch, (gu, gv))
