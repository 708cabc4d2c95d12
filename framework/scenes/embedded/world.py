"""The objects of the embedded scene: part of a room, from a lattice near the lens to a wall.

Units are metres. Axes are those of a camera (x right, y down, z away from the cameras around the
origin). Every solid has a centre, a frame, half sizes and a material. Nothing is random.
"""

from dataclasses import dataclass, replace

from framework.scenes.embedded.arrays import BOX, CYLINDER, ELLIPSOID
from framework.scenes.embedded.vectors import Frame, Vector, along, looking

UPRIGHT: Frame = looking((0.0, 0.0, 1.0))


@dataclass(frozen=True)
class Material:
    """The look of a surface.

    Attributes:
        texture: name in `textures.py`, "" = plain.
        tint: multiplies the texture.
        repeat: metres per tile, 0 = one picture per face.
        contrast: scales the texture about its mean.
        highlight: strength of the Blinn-Phong lobe.
        mirror: share of the mirror image.
        glow: extra ambient light.
    """

    texture: str = ""
    tint: Vector = (1.0, 1.0, 1.0)
    repeat: float = 0.0
    contrast: float = 1.0
    highlight: float = 0.0
    mirror: float = 0.0
    glow: float = 0.0


@dataclass(frozen=True)
class Solid:
    """half: half sizes along the frame's axes. casts: whether it shades others."""

    shape: int
    center: Vector
    half: Vector
    material: Material
    frame: Frame = UPRIGHT
    casts: bool = True


PLASTER = Material("gravel", (3.0, 2.9, 2.7), repeat=1.4, contrast=0.05)
BRICK = Material("brick", (2.6, 1.55, 1.15), repeat=1.9, contrast=0.85)
CARPET = Material("grass", (1.7, 0.95, 0.80), repeat=1.6, contrast=0.8)
WOOD = Material("grass", (2.2, 1.35, 0.75), repeat=0.9, contrast=0.35, highlight=0.12)
FRAME_WOOD = Material(tint=(0.12, 0.08, 0.06), highlight=0.2)
STEEL = Material(tint=(0.10, 0.11, 0.13), highlight=0.5)
BRASS = Material(tint=(0.75, 0.52, 0.18), highlight=0.8)
CHROME = Material(tint=(0.16, 0.17, 0.18), highlight=0.7, mirror=0.75)
GLAZE = Material(tint=(0.05, 0.16, 0.34), highlight=0.9, mirror=0.12)
STONE = Material("gravel", (1.5, 1.45, 1.35), repeat=0.9, contrast=0.8)
TERRACOTTA = Material("gravel", (1.9, 0.85, 0.5), repeat=0.5, contrast=0.35)
CUPBOARD = Material(tint=(0.46, 0.52, 0.47))
LAMP = Material(tint=(0.95, 0.90, 0.78), glow=1.6)


def _room() -> list[Solid]:
    """Floor, back wall, ceiling and side walls; they enclose every ray that leaves a camera."""
    walls = [
        Solid(BOX, (0.0, 1.6, 4.6), (4.0, 0.1, 3.0), CARPET),
        Solid(BOX, (0.0, -0.65, 7.6), (4.0, 2.35, 0.1), BRICK),
        Solid(BOX, (0.0, -2.9, 4.6), (4.0, 0.1, 3.0), PLASTER),
        Solid(BOX, (-3.9, -0.65, 4.6), (0.1, 2.35, 3.0), PLASTER),
        Solid(BOX, (4.0, -0.65, 4.6), (0.1, 2.35, 3.0), PLASTER),
    ]
    return [replace(wall, casts=False) for wall in walls]


def _picture(
    texture: str, x: float, y: float, half_width: float, half_height: float
) -> list[Solid]:
    """A framed photograph on the back wall."""
    border = Solid(BOX, (x, y, 7.44), (half_width + 0.09, half_height + 0.09, 0.06), FRAME_WOOD)
    photo = Material(texture, (1.25, 1.25, 1.25))
    return [border, Solid(BOX, (x, y, 7.40), (half_width, half_height, 0.05), photo)]


def _furniture() -> list[Solid]:
    """The table with its legs, the weakly textured cupboard, a shelf, a brick pillar."""
    legs = [
        Solid(BOX, (x, 1.17, z), (0.045, 0.33, 0.045), WOOD)
        for x in (-1.35, 1.35)
        for z in (3.15, 4.75)
    ]
    return [
        Solid(BOX, (0.0, 0.80, 3.95), (1.5, 0.04, 0.95), WOOD),
        *legs,
        Solid(BOX, (2.75, 0.25, 6.9), (0.85, 1.25, 0.5), CUPBOARD),
        Solid(BOX, (2.75, 0.25, 6.39), (0.012, 1.2, 0.012), FRAME_WOOD),
        Solid(ELLIPSOID, (2.65, 0.3, 6.36), (0.03, 0.03, 0.03), BRASS),
        Solid(ELLIPSOID, (2.85, 0.3, 6.36), (0.03, 0.03, 0.03), BRASS),
        Solid(CYLINDER, (-2.55, -0.6, 5.6), (0.34, 2.3, 0.34), replace(STONE, repeat=2.2)),
    ]


def _still_life() -> list[Solid]:
    """On the table: boxes with photographs, a mug, a mirror ball, a glazed vase, a stone."""
    cat = Material("chelsea", (1.2, 1.2, 1.2), highlight=0.1)
    coffee = Material("coffee", (1.3, 1.3, 1.3), highlight=0.3)
    page = Material("page", (1.0, 1.0, 1.0))
    coins = Material("coins", (1.5, 1.3, 0.9))
    return [
        Solid(BOX, (-0.78, 0.36, 4.25), (0.46, 0.40, 0.18), cat, looking((0.28, 0.0, 1.0))),
        Solid(CYLINDER, (-0.12, 0.51, 3.65), (0.21, 0.25, 0.21), coffee),
        Solid(ELLIPSOID, (0.42, 0.44, 3.95), (0.32, 0.32, 0.32), CHROME),
        Solid(ELLIPSOID, (1.02, 0.40, 4.35), (0.24, 0.37, 0.24), GLAZE),
        Solid(CYLINDER, (1.02, 0.0, 4.35), (0.09, 0.10, 0.09), GLAZE),
        Solid(ELLIPSOID, (0.83, 0.63, 3.45), (0.25, 0.14, 0.19), STONE, looking((0.4, 0.1, 1.0))),
        Solid(BOX, (-0.62, 0.72, 3.35), (0.30, 0.045, 0.21), page, looking((-0.35, 0.0, 1.0))),
        Solid(BOX, (0.30, 0.745, 3.22), (0.20, 0.02, 0.14), coins, looking((0.3, 0.0, 1.0))),
        Solid(
            BOX,
            (0.15, 0.25, 4.65),
            (0.30, 0.52, 0.05),
            Material("immunohistochemistry", (1.2, 1.2, 1.2)),
        ),
    ]


def _lattice() -> list[Solid]:
    """The thin occluders, nearest to the lens: a steel lattice at the left, two slanted wires."""
    upright = [
        Solid(BOX, (-1.22 + 0.17 * k, 0.1, 2.15 + 0.03 * k), (0.011, 1.3, 0.011), STEEL)
        for k in range(4)
    ]
    rails = [
        Solid(BOX, (-0.97, y, 2.2), (0.30, 0.012, 0.012), STEEL, looking((-0.17, 0.0, 1.0)))
        for y in (-0.55, -0.05, 0.62)
    ]
    wires = [
        Solid(CYLINDER, (0.3, -0.92, 3.0), (0.008, 2.0, 0.008), STEEL, along((1.0, 0.16, 0.1))),
        Solid(CYLINDER, (0.3, -0.78, 3.2), (0.008, 2.0, 0.008), BRASS, along((1.0, -0.10, -0.2))),
    ]
    return upright + rails + wires


def _plant() -> list[Solid]:
    """A potted plant at the right: thin leaves at many depths and slants."""
    leaves = []
    for k in range(15):
        sway = ((k * 7) % 15 - 7) / 7.0
        lean = ((k * 4) % 15 - 7) / 7.0
        length = 0.34 + 0.02 * ((k * 11) % 9)
        direction = (0.75 * sway, -1.0, 0.55 * lean)
        center = (1.18 + 0.85 * sway * length, 0.42 - length, 2.75 + 0.6 * lean * length)
        green = Material("grass", (0.55, 1.5 - 0.04 * k, 0.35), repeat=0.35, highlight=0.15)
        half = (0.035 + 0.003 * (k % 4), length, 0.008)
        leaves.append(Solid(ELLIPSOID, center, half, green, along(direction)))
    pot = Solid(CYLINDER, (1.18, 0.72, 2.75), (0.20, 0.24, 0.20), TERRACOTTA)
    stool = Solid(CYLINDER, (1.18, 1.23, 2.75), (0.27, 0.27, 0.27), WOOD)
    return [*leaves, pot, stool]


def _hanging() -> list[Solid]:
    """A lamp on its cord and a chrome rail far up."""
    return [
        Solid(ELLIPSOID, (-0.55, -1.12, 4.9), (0.34, 0.27, 0.34), LAMP),
        Solid(CYLINDER, (-0.55, -2.1, 4.9), (0.012, 0.75, 0.012), STEEL),
        Solid(CYLINDER, (1.6, -1.75, 5.8), (0.05, 2.2, 0.05), CHROME, along((1.0, 0.0, 0.05))),
    ]


def solids() -> list[Solid]:
    """Everything in the scene, in a fixed order (the first wins a tie in depth)."""
    return [
        *_room(),
        *_picture("astronaut", -0.9, -0.55, 0.72, 0.72),
        *_picture("moon", 1.0, -0.75, 0.50, 0.50),
        *_furniture(),
        *_still_life(),
        *_lattice(),
        *_plant(),
        *_hanging(),
    ]
