"""3-vectors as tuples of floats, with the same bits on every machine.

They use `+ - * /` and `sqrt` only, which IEEE 754 rounds exactly. A BLAS product or a library `sin`
may differ in the last bit.
"""

import math

Vector = tuple[float, float, float]
Frame = tuple[Vector, Vector, Vector]  # the x, y and z axis of a right-handed orthonormal frame


def cross(a: Vector, b: Vector) -> Vector:
    """The vector product a x b."""
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


def dot(a: Vector, b: Vector) -> float:
    """The inner product, summed from left to right."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def unit(a: Vector) -> Vector:
    """`a` scaled to length 1."""
    length = math.sqrt(dot(a, a))
    return (a[0] / length, a[1] / length, a[2] / length)


def looking(forward: Vector, down: Vector = (0.0, 1.0, 0.0)) -> Frame:
    """The frame with its z axis along `forward` and its y axis as near `down` as can be."""
    z = unit(forward)
    x = unit(cross(down, z))
    return x, cross(z, x), z


def along(direction: Vector) -> Frame:
    """A frame whose y axis points along `direction` (not parallel to the world's z)."""
    y = unit(direction)
    x = unit(cross(y, (0.0, 0.0, 1.0)))
    return x, y, cross(x, y)
