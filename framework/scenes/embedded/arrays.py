"""What the ray tracer reads: the scene as a few flat arrays.

Few and plain on purpose: numba counts references atomically whenever an array leaves a tuple, which
costs more than the arithmetic of a ray.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

BOX, ELLIPSOID, CYLINDER = 0, 1, 2

# columns of `World.solids`
CENTER = 0  # x y z
AXES = 3  # three rows of the world-to-local rotation
HALF = 12  # half sizes along the local axes (cylinder: x radius, half height, z radius)
SHAPE = 15  # BOX, ELLIPSOID or CYLINDER
TINT = 16  # r g b
REPEAT = 19  # metres per texture tile, 0 = one picture per face
CONTRAST = 20
HIGHLIGHT = 21
MIRROR = 22
GLOW = 23
TEXTURE = 24  # offset in `World.texels`, height, width; offset -1 = plain
MEAN = 27  # r g b, linear mean of the texture

# columns of `World.lights`
TOWARDS = 0  # unit vector to the light
ACROSS = 3  # two axes across its rays
GRID = 9  # origin along both axes, size of a cell


class World(NamedTuple):
    """P solids and L light directions over G x G light cells.

    Attributes:
        solids: [P, 30] float64.
        texels: [*] uint8, all textures one after another, row-major RGB.
        lights: [L, 12] float64.
        casters: [L, G, G, P + 1] int16, the solids that may shade what lies in a cell, ended by -1.
    """

    solids: NDArray[np.float64]
    texels: NDArray[np.uint8]
    lights: NDArray[np.float64]
    casters: NDArray[np.int16]


class Tiles(NamedTuple):
    """The solids a camera may meet first in each tile of `size` x `size` pixels.

    Attributes:
        members: [T + 1, P + 1] int16, row-major tiles, each list ended by -1; the last one lists
            all.
    """

    size: int
    members: NDArray[np.int16]
