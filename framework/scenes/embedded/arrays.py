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
BALL = 30  # squared radius of a ball around the solid
CASTS = 31  # 1 if it shades others, else 0


class World(NamedTuple):
    """P solids and L light directions.

    Attributes:
        solids: [P, 32] float64.
        texels: [*] uint8, all textures one after another, row-major RGB.
        lights: [L, 3] float64, unit vectors to the light.
    """

    solids: NDArray[np.float64]
    texels: NDArray[np.uint8]
    lights: NDArray[np.float64]
