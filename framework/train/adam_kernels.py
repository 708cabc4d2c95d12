"""The kernels of `framework.train.optim`: Adam's update, also straight from a gradient on the
screen.

Every element is computed alone, in float32 and without contraction, so the bits do not depend on
threads or blocks, nor on which of the two kernels it is.
"""

import math

import numpy as np

from framework.compute.chunks import put1, span, take1
from framework.compute.jit import inlined, kernel
from framework.compute.simd import LANES, exp2, log2, maximum, splat
from framework.kernels.project.backward import project_backward

BETA1, BETA2, EPS = 0.9, 0.999, 1e-15
LOWEST_LOGIT = -30.0
CHUNK = 256  # Gaussians whose gradient waits in the cache for their update
_LN2, _LOG2E = np.float32(math.log(2)), np.float32(1 / math.log(2))


@kernel
def _adam_range(p, g, m, v, rate, correction):
    """p -= rate * m / (sqrt(v) * correction + eps), after the moments m and v took g in; returns
    how many p or v are not finite now.

    rate = learning rate / (1 - beta1^t), correction = 1 / sqrt(1 - beta2^t). A first moment below
    1e-30 becomes 0, since it moves a parameter by less than 1e-15 rates. Decaying moments of unseen
    Gaussians would otherwise end as denormals, which cost six times as much.
    """
    beta1, beta2 = np.float32(BETA1), np.float32(BETA2)
    # not 1 - float32(beta), whose rounding is 1e-5 of a share this small
    share1, share2 = np.float32(1 - BETA1), np.float32(1 - BETA2)
    eps, tiny, infinity = np.float32(EPS), np.float32(1e-30), np.float32(np.inf)
    finite = np.int32(0)
    for i in range(len(p)):
        first = beta1 * m[i] + share1 * g[i]
        first = first if abs(first) >= tiny else np.float32(0)
        second = beta2 * v[i] + share2 * (g[i] * g[i])
        m[i] = first
        v[i] = second
        value = p[i] - rate * first / (np.sqrt(second) * correction + eps)
        p[i] = value
        # an integer sum, which the compiler may reorder and so vectorise; NaN compares false
        finite += np.int32(abs(value) + second < infinity)
    return len(p) - finite


@kernel
def _decay_range(logits, begin, end, decay):
    """Multiply the opacities sigmoid(logits[begin:end]) by `decay` in (0, 1).

    d sigmoid(l) = sigmoid(l'), l' = log d - log(1 - d + exp(-l)); Binocular3DGS applies such a
    decay so that Gaussians which no view confirms fade.
    """
    log_decay, lowest = np.float32(math.log(decay)), splat(np.float32(LOWEST_LOGIT))
    kept, scratch = np.float32(1) - decay, np.empty(LANES, np.float32)
    for base in range(begin, end, LANES):
        count = min(LANES, end - base)
        # exp(88) overflows; an opacity of 1e-13 is as good as none
        bounded = maximum(take1(logits, base, count, scratch), lowest)
        decayed = log_decay - _LN2 * log2(kept + exp2(-bounded * _LOG2E))
        put1(logits, base, count, scratch, maximum(decayed, lowest))


@kernel
def adam_kernel(block, n_blocks, p, g, m, v, coefficients, broken, logits, decay):
    """Block `block` of one Adam update of several tensors, and of the decay of opacities after it.

    Args:
        p, g, m, v: tuples of flat float32 arrays (parameters, gradients, moments), all
            C-contiguous.
        coefficients: [len(p), 2] float32, see `_adam_range`.
        broken: [n_blocks, len(p)] int32, out. logits [N], one of p unless it has no gradient, and
            decay: see `_decay_range`.
    """
    for k in range(len(p)):
        n = len(p[k])
        a, b = n * block // n_blocks, n * (block + 1) // n_blocks
        rate, correction = coefficients[k, 0], coefficients[k, 1]
        broken[block, k] = _adam_range(p[k][a:b], g[k][a:b], m[k][a:b], v[k][a:b], rate, correction)
    if decay < 1 and not np.any(broken[block]):  # else the error names what broke
        n = len(logits)
        _decay_range(logits, n * block // n_blocks, n * (block + 1) // n_blocks, decay)


@inlined
def _pieces(scratch, n, banded, per_shN):
    """Room in the scratch for the gradients of n <= CHUNK Gaussians: of the six tensors, the last
    of `banded` of them, and of the opacity factors."""
    return (
        scratch[: 3 * n],
        scratch[3 * CHUNK : 3 * CHUNK + 4 * n],
        scratch[7 * CHUNK : 7 * CHUNK + 3 * n],
        scratch[10 * CHUNK : 10 * CHUNK + n],
        scratch[11 * CHUNK : 11 * CHUNK + 3 * n],
        scratch[15 * CHUNK : 15 * CHUNK + per_shN * banded],
        scratch[14 * CHUNK : 14 * CHUNK + n],
    )


@inlined
def _pull_back(a, b, p, shN, factors, projected, g, g_offset):
    """`project_backward` for Gaussians a ... b - 1 alone, into the pieces g."""
    degree, camera, rows, clipped, first, sums = projected
    q = (p[0][3 * a : 3 * b], p[1][4 * a : 4 * b], p[2][3 * a : 3 * b], p[3][a:b])
    of_shN = g[5].reshape(len(shN[a:b]), shN.shape[1], 3)
    project_backward(
        0,
        1,
        (q[0], q[1], q[2], q[3], shN[a:b], factors[a:b]),
        (degree, camera, rows[16 * a : 16 * b], clipped[a:b], first[a : b + 1], sums),
        (g[0], g[1], g[2], g[3], g[4], of_shN, g[6], g_offset[2 * a : 2 * b]),
    )


@kernel
def pull_back_and_step(
    block,
    n_blocks,
    scratch,
    p,
    shN,
    factors,
    projected,
    g_offset,
    m,
    v,
    coefficients,
    banded,
    broken,
    decay,
):
    """Block `block` of `project_backward` and `adam_kernel` in one: the gradient of CHUNK Gaussians
    at a time goes to the scratch, from where it is used while the cache has it.

    Args:
        p, m, v: flat, of all tensors of `Gaussians` in their order.
        shN: [M, K, 3].
        scratch: float32[CHUNK (15 + 3 K)].
        banded: whether shN ever had a gradient; otherwise it is left alone and its moments stay 0.
            The others as in the two kernels.
    """
    per_shN = 3 * shN.shape[1]
    widths = (3, 4, 3, 1, 3, per_shN)
    begin, end = span(len(p[3]), block, n_blocks)
    broken[block, :] = 0
    for a in range(begin, end, CHUNK):
        b = min(a + CHUNK, end)
        g = _pieces(scratch, b - a, min(b, len(shN)) - min(a, len(shN)), per_shN)
        _pull_back(a, b, p, shN, factors, projected, g, g_offset)
        for k in range(len(p) if banded else len(p) - 1):
            i, j = widths[k] * a, widths[k] * b
            rate, correction = coefficients[k, 0], coefficients[k, 1]
            broken[block, k] += _adam_range(p[k][i:j], g[k], m[k][i:j], v[k][i:j], rate, correction)
    if decay < 1 and not np.any(broken[block]):
        _decay_range(p[3], begin, end, decay)
