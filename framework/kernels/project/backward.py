"""The gradient of what `projection` does: from sums over pixels back to the parameters."""

import numpy as np

from framework.compute.chunks import put1, put2, put3, put4, span, take1, take3, take4, take_row
from framework.compute.jit import inlined, kernel
from framework.compute.simd import (
    LANES,
    both,
    greater,
    load,
    load16,
    select,
    splat,
    store,
    zeros,
)
from framework.kernels.project.ewa import (
    conic_of,
    exp,
    pull_back,
    rotation,
    screen_axes,
    times_rotation,
    to_camera,
    unit_quat,
)
from framework.kernels.project.harmonics import Y0, direction, sh_backward

f4 = np.float32
ZERO, HALF, ONE = f4(0), f4(0.5), f4(1)


@inlined
def _sum_parts(first, sums, base, count, total):
    """The sum of every Gaussian's parts, in their order, into total (flat [16 16]), row 15 of
    which counts them; returns the number of parts."""
    for lane in range(count):
        begin, end = first[base + lane], first[base + lane + 1]
        part = zeros()
        for j in range(begin, end):
            part = part + load(sums, j * LANES)
        store(total, lane * LANES, part)
        total[lane * LANES + 15] = f4(end - begin)
    return first[base + count] - first[base]


@inlined
def _only3(seen, x, y, z):
    """0 for the lanes that are not seen."""
    o = zeros()
    return select(seen, x, o), select(seen, y, o), select(seen, z, o)


@inlined
def _zero(gradients, base, count):
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
def _unclamped(seen, clipped, base, count, sums, flags):
    """The gradient of the three colours, 0 where they were clamped. flags: scratch [3, 16]."""
    for lane in range(count):
        for c in range(3):
            flags[c, lane] = f4((clipped[base + lane] >> c) & 1)
    gr = select(both(seen, greater(splat(HALF), load(flags[0], 0))), sums[6], zeros())
    gg = select(both(seen, greater(splat(HALF), load(flags[1], 0))), sums[7], zeros())
    gb = select(both(seen, greater(splat(HALF), load(flags[2], 0))), sums[8], zeros())
    return gr, gg, gb


@inlined
def _through_direction(vx, vy, vz, way):
    """d / d mean from d / d direction; way: the unit direction and 1 / distance."""
    radial = vx * way[0] + vy * way[1] + vz * way[2]
    return (
        (vx - radial * way[0]) * way[3],
        (vy - radial * way[1]) * way[3],
        (vz - radial * way[2]) * way[3],
    )


@inlined
def _to_ellipse(sums, conic, seen):
    """Compute gradients in u, v, A, B, C from the sums of a = (d loss / d alpha) alpha, see
    `project_backward`.

    log(alpha) is lower than at the mean by (A dx^2 + 2 B dx dy + C dy^2) / 2.
    """
    ca, cb, cc = conic
    gu = select(seen, ca * sums[1] + cb * sums[3], zeros())
    gv = select(seen, cb * sums[1] + cc * sums[3], zeros())
    return gu, gv, -HALF * sums[2], -sums[4], -HALF * sums[5]


@inlined
def _to_opacity(g_opacity, logit, factor):
    """Gradients in factor and logit of the opacity: factor x sigmoid(logit)."""
    opacity = ONE / (ONE + exp(-logit))
    return g_opacity * opacity, g_opacity * factor * opacity * (ONE - opacity)


@kernel
def project_backward(block, blocks, gaussians, projected, gradients):
    """Sum every Gaussian's parts in their order, then pull the sums back to the parameters.

    The lanes of a part are sums over pixels. Lanes 0 to 5 are of a = (d loss / d alpha) alpha times
    1, dx, dx^2, dy, dx dy, dy^2, then follows weight times d loss / d (r, g, b, depth), see
    `blend.blend_backward`.

    Args:
        gaussians: means, quats, log-scales, logits, shN and factors.
        projected: degree, camera, rows, clipped, each Gaussian's first part, and the parts' sums.
        gradients: out, as `Arrays.flat`.
    """
    means, quats, log_scales, logits, shN, factors = gaussians
    degree, camera, rows, clipped, first, sums = projected
    g_means, g_quats, g_log_scales, g_logits, g_sh0, g_shN, g_factors, g_offset = gradients
    n = len(logits)
    scratch, total = np.empty(4 * LANES, np.float32), np.zeros(256, np.float32)
    sh, flags = np.zeros((2, 256), np.float32), np.zeros((3, LANES), np.float32)
    terms = (degree + 1) * (degree + 1) - 1
    start, end = span(n, block, blocks)
    for base in range(start, end, LANES):
        count = min(LANES, end - base)
        if _sum_parts(first, sums, base, count, total) == 0:
            _zero(gradients, base, count)
            continue
        s = load16(total, 0)
        row = take_row(rows, base, count, total)
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
