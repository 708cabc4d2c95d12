"""The scene of `world.py` as the arrays of `arrays.py`, with the lists that make tracing fast.

A list of candidates must contain every solid that could be hit. A solid lies inside its box, and
the box projects into the bounding rectangle of its corners. How tight a list is does not change a
bit of the image.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from framework.scenes.embedded import textures
from framework.scenes.embedded.arrays import Tiles, World
from framework.scenes.embedded.vectors import cross, unit
from framework.scenes.embedded.world import Material, Solid, solids

LIGHT_FROM = (-0.62, -0.95, -0.85)  # towards the window behind the viewers' left shoulder
LIGHT_RADIUS = 0.12  # of the square of light directions, about its middle
CELLS = 48  # light cells along each side
TILE = 8  # pixels


def _tuned(material: Material, texture: float, gloss: float) -> Material:
    return replace(
        material,
        contrast=material.contrast * texture,
        highlight=material.highlight * gloss,
        mirror=min(1.0, material.mirror * gloss),
    )


def _row(solid: Solid, m: Material, shapes: NDArray, means: NDArray) -> list[float]:
    """One row of `World.solids`, in the order of the columns in `arrays.py`."""
    frame = [c for axis in solid.frame for c in axis]
    look = [*m.tint, m.repeat, m.contrast, m.highlight, m.mirror, m.glow]
    index = textures.NAMES.index(m.texture) if m.texture else -1
    texture = [-1.0, 0.0, 0.0, 0.0, 0.0, 0.0] if index < 0 else [*shapes[index], *means[index]]
    return [*solid.center, *frame, *solid.half, solid.shape, *look, *texture]


def _lights(n: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """n x n directions towards the light and, for each, two axes across it."""
    main = unit(LIGHT_FROM)
    a = unit(cross(main, (0.0, 1.0, 0.0)))
    b = cross(main, a)
    directions, axes = [], []
    for k in range(n * n):
        s = LIGHT_RADIUS * ((2 * (k % n) + 1) / n - 1.0)
        t = LIGHT_RADIUS * ((2 * (k // n) + 1) / n - 1.0)
        x, y, z = (main[i] + s * a[i] + t * b[i] for i in range(3))
        light = unit((x, y, z))
        u = unit(cross(light, (0.0, 1.0, 0.0)))
        directions.append(light)
        axes.append([u, cross(light, u)])
    return np.array(directions), np.array(axes)


def corners(things: list[Solid]) -> NDArray[np.float64]:
    """[P, 8, 3] corners of the solids' boxes in the world, by elementwise arithmetic."""
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
    center = np.array([s.center for s in things])[:, None, :]
    half = np.array([s.half for s in things])
    frame = np.array([s.frame for s in things])  # [P, axis, xyz]
    out = np.repeat(center, 8, axis=1)
    for axis in range(3):
        out = out + (signs[None, :, axis, None] * half[:, None, axis, None]) * frame[:, None, axis]
    return out


def _lists(member: NDArray[np.bool_]) -> NDArray[np.int16]:
    """[..., P] membership as [..., P + 1] indices in order, ended by -1."""
    order = np.argsort(~member, axis=-1, kind="stable").astype(np.int16)
    listed = np.arange(member.shape[-1]) < member.sum(axis=-1)[..., None]
    end = np.full((*member.shape[:-1], 1), -1, dtype=np.int16)
    return np.concatenate([np.where(listed, order, np.int16(-1)), end], axis=-1)


def _covers(low: NDArray[np.float64], high: NDArray[np.float64], n: int) -> NDArray[np.bool_]:
    """[n, P]: cell k (from k to k + 1) meets [low, high], with a margin for rounding."""
    k = np.arange(n)[:, None]
    return (low[None] <= k + 1 + 1e-6) & (high[None] >= k - 1e-6)


def _shadow_lists(
    points: NDArray[np.float64], casts: NDArray[np.bool_], axes: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.int16]]:
    """The light grid (u origin, v origin, cell size) and each light cell's casters."""
    u, v, w = (points[None, None, :, :, k] * axes[:, :, None, None, k] for k in range(3))
    flat = u + v + w
    low, high = flat.min(axis=3), flat.max(axis=3)  # [L, 2, P]
    origin = low[:, :, casts].min(axis=(0, 2)) - 1e-3
    cell = (high[:, :, casts].max(axis=(0, 2)) - origin).max() / (CELLS - 1)
    first = (low - origin[:, None]) / cell
    last = (high - origin[:, None]) / cell
    member = np.stack(
        [
            _covers(a[0], b[0], CELLS)[:, None, :] & _covers(a[1], b[1], CELLS)[None] & casts
            for a, b in zip(first, last, strict=True)
        ]
    )
    return np.array([origin[0], origin[1], cell]), _lists(member)


def build_world(texture: float, gloss: float, samples: int) -> World:
    """The scene; `texture` scales all texture contrasts, `gloss` all highlights and mirrors. The
    light has one direction for each of a pixel's samples x samples rays."""
    things = solids()
    texels, shapes, means = textures.pack()
    rows = [_row(s, _tuned(s.material, texture, gloss), shapes, means) for s in things]
    lights, axes = _lights(samples)
    casts = np.array([s.casts for s in things])
    grid, casters = _shadow_lists(corners(things), casts, axes)
    grids = np.repeat(grid[None], len(lights), axis=0)
    return World(
        solids=np.array(rows, dtype=np.float64),
        texels=texels,
        lights=np.concatenate([lights, axes.reshape(-1, 6), grids], axis=1),
        casters=casters,
    )


def camera_tiles(pose: NDArray[np.float64], focal: float, width: int, height: int) -> Tiles:
    """The solids each tile of a camera may see.

    Args:
        pose: [3, 4] camera-to-world.
        focal: pixels.
    """
    away = corners(solids()) - pose[:, 3]
    x, y, z = (sum(away[:, :, k] * pose[k, axis] for k in range(3)) for axis in range(3))
    behind = (z < 0.05).any(axis=1)
    safe = np.where(z < 0.05, 1.0, z)
    u = (focal * x / safe + 0.5 * width) / TILE
    v = (focal * y / safe + 0.5 * height) / TILE
    columns = _covers(u.min(axis=1), u.max(axis=1), -(-width // TILE))
    rows = _covers(v.min(axis=1), v.max(axis=1), -(-height // TILE))
    member = ((rows[:, None] & columns[None]) | behind).reshape(-1, len(behind))
    everything = np.ones((1, len(behind)), dtype=bool)
    return Tiles(TILE, _lists(np.concatenate([member, everything])))
