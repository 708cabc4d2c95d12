"""Winner-take-all over an aggregated cost volume, with sub-plane refinement, kernel."""

import numpy as np

from framework.compute.jit import kernel
from framework.depth.matching.match import COST_ONE

_F = np.float32
_ONE = np.float32(COST_ONE)


@kernel
def select_planes(block, n_blocks, total, cost, position, zncc):
    """Kernel over rows.

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
