"""Semi-global aggregation of a cost volume [H, D, W] int16 along four paths, and the choice of the
plane with the lowest total, as kernels.

    L(p, d) = C(p, d) + min(L(o, d), L(o, d +- 1) + P1, min_k L(o, k) + P2(p)) - min_k L(o, k)

Here o is the pixel before p on the path. The total is the sum of L over the paths left, right, up
and down (Hirschmueller, TPAMI 2008, eq. 13-14). P2 is lower at image edges between o and p. Rows of
`L` are padded on both ends of d by a value above any cost, which avoids branches.
"""

import numpy as np

from framework.compute.jit import kernel
from framework.depth.matching.match import COST_ONE

_F = np.float32
_ONE = np.float32(COST_ONE)
_I = np.int16
_BEYOND = np.int16(16000)


@kernel
def _path_step(cost, before, low, small, jump, after):
    """One pixel of a horizontal path: all d. Returns the new minimum; `before` is padded."""
    n = cost.shape[0]
    left, middle, right = before[:n], before[1 : n + 1], before[2 : n + 2]
    out = after[1 : n + 1]
    for d in range(n):
        a = _I(left[d] + small)
        b = _I(right[d] + small)
        v = middle[d]
        v = a if a < v else v
        v = b if b < v else v
        v = jump if jump < v else v
        out[d] = _I(cost[d] + v - low)
    minimum = _BEYOND
    for d in range(n):
        minimum = out[d] if out[d] < minimum else minimum
    return minimum


@kernel
def _sweep_row(cost, total, penalty, small, backward, before, after):
    """Add the left-to-right (or right-to-left) path of one row; cost, total [W, D]."""
    width, planes = cost.shape
    before[:] = _BEYOND
    after[:] = _BEYOND
    before[1 : planes + 1] = _I(0)
    low = _I(0)
    for step in range(width):
        x = width - 1 - step if backward else step
        between = penalty[x + 1] if backward and step > 0 else penalty[x]
        low = _path_step(cost[x], before, low, small, _I(low + between), after)
        out = after[1 : planes + 1]
        row = total[x]
        for d in range(planes):
            row[d] = _I(row[d] + out[d])
        before, after = after, before


@kernel
def aggregate_rows(block, n_blocks, cost, penalty, small, total):
    """Kernel over rows: total[y] = sum of both horizontal paths. penalty [H, W] int16: P2 between a
    pixel and its left neighbour."""
    height, planes, width = cost.shape
    costs = np.empty((width, planes), np.int16)
    sums = np.empty((width, planes), np.int16)
    before = np.empty(planes + 2, np.int16)
    after = np.empty(planes + 2, np.int16)
    for y in range(block * height // n_blocks, (block + 1) * height // n_blocks):
        for x in range(width):
            for d in range(planes):
                costs[x, d] = cost[y, d, x]
        sums[:] = _I(0)
        _sweep_row(costs, sums, penalty[y], small, False, before, after)
        _sweep_row(costs, sums, penalty[y], small, True, before, after)
        for d in range(planes):
            for x in range(width):
                total[y, d, x] = sums[x, d]


@kernel
def _column_step(cost, start, before, low, jump, small, after, total):
    """One row of a vertical path over the columns from `start`: cost, total [D, W]; low, jump [n].
    Slices are taken row by row here: numba must see that they are contiguous to vectorise."""
    planes, n = cost.shape[0], low.shape[0]
    for d in range(planes):
        left, middle, right = before[d], before[d + 1], before[d + 2]
        c, out, row = cost[d, start : start + n], after[d + 1], total[d, start : start + n]
        for x in range(n):
            a = left[x] if left[x] < right[x] else right[x]
            a = _I(a + small)
            v = middle[x]
            v = a if a < v else v
            v = jump[x] if jump[x] < v else v
            out[x] = _I(c[x] + v - low[x])
        for x in range(n):
            row[x] = _I(row[x] + out[x])
    low[:] = _BEYOND
    for d in range(planes):
        out = after[d + 1]
        for x in range(n):
            low[x] = out[x] if out[x] < low[x] else low[x]


@kernel
def aggregate_columns(block, n_blocks, cost, penalty, small, total):
    """Kernel over columns: total += both vertical paths. penalty [H, W] int16: P2 between a pixel
    and the one above. Blocks start at multiples of 16 columns, for whole vectors."""
    height, planes, width = cost.shape
    share = (width + 16 * n_blocks - 1) // (16 * n_blocks) * 16
    start, stop = min(block * share, width), min((block + 1) * share, width)
    n = stop - start
    before = np.empty((planes + 2, n), np.int16)
    after = np.empty((planes + 2, n), np.int16)
    low = np.empty(n, np.int16)
    jump = np.empty(n, np.int16)
    for backward in range(2):
        before[:] = _BEYOND
        after[:] = _BEYOND
        before[1 : planes + 1] = _I(0)
        low[:] = _I(0)
        for step in range(height if n > 0 else 0):
            y = height - 1 - step if backward == 1 else step
            between = penalty[y + 1] if backward == 1 and step > 0 else penalty[y]
            for x in range(n):
                jump[x] = _I(low[x] + between[start + x])
            _column_step(cost[y], start, before, low, jump, small, after, total[y])
            before, after = after, before


@kernel
def select_planes(block, n_blocks, total, cost, position, zncc):
    """Choose the plane of every pixel. Kernel over rows.

    position [H, W] float32: plane index of the lowest total, refined by the parabola through it and
    its neighbours. zncc [H, W] float32: at that plane.
    """
    height, planes, width = total.shape
    lowest = np.empty(width, np.int16)
    winner = np.empty(width, np.int16)
    for y in range(block * height // n_blocks, (block + 1) * height // n_blocks):
        lowest[:] = total[y, 0]
        winner[:] = np.int16(0)
        for d in range(1, planes):
            row, index = total[y, d], np.int16(d)
            for x in range(width):
                winner[x] = index if row[x] < lowest[x] else winner[x]
                lowest[x] = row[x] if row[x] < lowest[x] else lowest[x]
        for x in range(width):
            k = np.int64(winner[x])
            shift = _F(0.0)
            if 0 < k < planes - 1:
                below, above = _F(total[y, k - 1, x]), _F(total[y, k + 1, x])
                curvature = below - _F(2.0) * _F(lowest[x]) + above
                if curvature > _F(0.0):
                    shift = _F(0.5) * (below - above) / curvature
            position[y, x] = _F(k) + shift
            zncc[y, x] = _F(1.0) - _F(cost[y, k, x]) / _ONE
