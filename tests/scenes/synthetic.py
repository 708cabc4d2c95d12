"""Small COLMAP and LLFF folders on disk, made for one test."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from framework.compute.rng import stream

WIDTH, HEIGHT, FOCAL = 40, 30, 50.0
Point = tuple[tuple[float, float, float], Sequence[int]]  # xyz, indices of the images in its track


def write_images(folder: Path, n: int, width: int = WIDTH, height: int = HEIGHT) -> None:
    """n noise images `im00.png` ..."""
    folder.mkdir(parents=True, exist_ok=True)
    for i in range(n):
        pixels = stream(i, "tests/synthetic").integers(0, 256, (height, width, 3), dtype=np.uint8)
        Image.fromarray(pixels).save(folder / f"im{i:02d}.png")


def write_model(
    folder: Path, n: int, points: Sequence[Point], camera: str = "", center_step: float = 0.1
) -> None:
    """A text model: camera i is at x = center_step * i and looks along z."""
    folder.mkdir(parents=True, exist_ok=True)
    camera = camera or f"PINHOLE {WIDTH} {HEIGHT} {FOCAL} {FOCAL} {WIDTH / 2} {HEIGHT / 2}"
    (folder / "cameras.txt").write_text(f"# Number of cameras: 1\n1 {camera}\n")
    observations: list[list[str]] = [[] for _ in range(n)]
    rows = []
    for k, ((x, y, z), track) in enumerate(points):
        elements = []
        for i in track:
            u = FOCAL * (x - center_step * i) / z + WIDTH / 2
            v = FOCAL * y / z + HEIGHT / 2
            elements.append(f"{i + 1} {len(observations[i])}")
            observations[i].append(f"{u} {v} {k + 1}")
        rows.append(f"{k + 1} {x} {y} {z} {k % 256} 7 9 0.1 {' '.join(elements)}")
    lines = []
    for i in range(n):
        lines.append(f"{i + 1} 1 0 0 0 {-center_step * i} 0 0 1 im{i:02d}.png")
        lines.append(" ".join(observations[i]))
    (folder / "images.txt").write_text(f"# Number of images: {n},\n" + "\n".join(lines) + "\n")
    header = f"# Number of points: {len(rows)}, mean track length: 2\n"
    (folder / "points3D.txt").write_text(header + "\n".join(rows) + "\n")


def write_scene(folder: Path, n: int = 10, points: Sequence[Point] | None = None) -> Path:
    """A complete COLMAP scene of n images; by default two points that all images see."""
    everyone = tuple(range(n))
    default: list[Point] = [((0.3, 0.1, 4.0), everyone), ((-0.2, 0.0, 6.0), everyone)]
    write_images(folder / "images", n)
    write_model(folder / "sparse" / "0", n, default if points is None else points)
    return folder


def llff_rows(n: int = 10, factor: int = 8) -> np.ndarray:
    """[n, 17] poses_bounds: camera i at x = 0.1 i, looking along z (down, right, backward axes)."""
    rows = np.zeros((n, 17))
    for i in range(n):
        pose = np.array(
            [
                [0.0, 1.0, 0.0, 0.1 * i, HEIGHT * factor],
                [1.0, 0.0, 0.0, 0.0, WIDTH * factor],
                [0.0, 0.0, -1.0, 0.0, FOCAL * factor],
            ]
        )
        rows[i] = [*pose.reshape(-1), 2.0 + 0.1 * i, 9.0 + 0.1 * i]
    return rows


def write_llff(folder: Path, n: int = 10) -> Path:
    """An LLFF scene of n images without a sparse model."""
    write_images(folder / "images_8", n)
    np.save(folder / "poses_bounds.npy", llff_rows(n))
    return folder


def write_table(path: Path, rows: np.ndarray, text: bool = False, order: str = "<") -> None:
    """A PLY file whose only element is `vertex`, of a structured array."""
    kinds = {"f4": "float", "f8": "double", "u1": "uchar", "i4": "int"}
    form = "ascii" if text else f"binary_{'little' if order == '<' else 'big'}_endian"
    names = rows.dtype.names or ()
    properties = [f"property {kinds[rows.dtype[name].str[1:]]} {name}" for name in names]
    head = ["ply", f"format {form} 1.0", f"element vertex {len(rows)}", *properties, "end_header"]
    body = rows.astype([(name, order + rows.dtype[name].str[1:]) for name in names]).tobytes()
    if text:
        body = "".join(" ".join(map(str, row.tolist())) + "\n" for row in rows).encode()
    path.write_bytes("\n".join(head).encode() + b"\n" + body)
