"""Photos of a small textured room, as cameras with known poses would take them."""

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image
from skimage import data

WIDTH, HEIGHT, FOCAL = 320, 240, 300.0
FILM_MM = 32  # 35 mm equivalent of FOCAL: 300 / 400 x 43.27

# picture and the corners it is stretched over, farthest first: upper left, upper right, lower
# right, lower left; x to the right, y down, z ahead
QUADS = (
    (data.astronaut, ((-6, -4, 9), (6, -4, 9), (6, 4, 9), (-6, 4, 9))),
    (data.coffee, ((-6, 1.6, 9), (6, 1.6, 9), (3, 1.6, 2.2), (-3, 1.6, 2.2))),
    (data.chelsea, ((-2.6, -1.2, 4.5), (-0.4, -1.2, 6.0), (-0.4, 1.6, 6.0), (-2.6, 1.6, 4.5))),
    (data.rocket, ((0.5, -0.9, 5.2), (2.5, -0.9, 4.2), (2.5, 1.6, 4.2), (0.5, 1.6, 5.2))),
)


def viewmat(x: float, y: float = 0.0, z: float = 0.0) -> NDArray[np.float64]:
    """[4, 4] world-to-camera of a camera at (x, y, z) that looks at (0, 0.3, 5.5)."""
    center = np.array([x, y, z])
    ahead = np.array([0.0, 0.3, 5.5]) - center
    ahead /= np.linalg.norm(ahead)
    right = np.cross([0.0, 1.0, 0.0], ahead)
    right /= np.linalg.norm(right)
    view = np.eye(4)
    view[:3, :3] = np.stack([right, np.cross(ahead, right), ahead])
    view[:3, 3] = -view[:3, :3] @ center
    return view


def photograph(view: NDArray[np.float64]) -> NDArray[np.uint8]:
    """[HEIGHT, WIDTH, 3] of the room, two samples per pixel along each axis."""
    K = np.array([[2 * FOCAL, 0, WIDTH], [0, 2 * FOCAL, HEIGHT], [0, 0, 1]])
    size = (2 * WIDTH, 2 * HEIGHT)
    canvas = np.full((2 * HEIGHT, 2 * WIDTH, 3), 90, np.uint8)
    for picture, corners in QUADS:
        pixels = picture()
        h, w = pixels.shape[:2]
        seen = (np.array(corners, float) @ view[:3, :3].T + view[:3, 3]) @ K.T
        to = (seen[:, :2] / seen[:, 2:]).astype(np.float32)
        at = np.array([(0, 0), (w, 0), (w, h), (0, h)], np.float32)
        warp = cv2.getPerspectiveTransform(at, to)
        drawn = cv2.warpPerspective(pixels, warp, size, flags=cv2.INTER_AREA)
        inside = cv2.warpPerspective(np.ones((h, w), np.uint8), warp, size) > 0
        canvas[inside] = drawn[inside]
    small = cv2.resize(canvas, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
    return np.asarray(small, np.uint8)


def rig(n: int) -> list[NDArray[np.float64]]:
    """n cameras side by side, alternately higher and lower."""
    return [viewmat(x, 0.25 * (-1) ** k) for k, x in enumerate(np.linspace(-1.5, 1.5, n))]


def exif_of(orientation: int = 1, film_mm: int | None = FILM_MM) -> Image.Exif:
    """EXIF with an orientation and, unless None, a focal length."""
    exif = Image.Exif()
    exif[0x0112] = orientation
    if film_mm is not None:
        exif.get_ifd(0x8769)[0xA405] = film_mm
    return exif


def write_photos(folder: Path, n: int = 6) -> Path:
    """n JPEGs `room0.jpg` ... as a camera writes them."""
    folder.mkdir(parents=True, exist_ok=True)
    for k, view in enumerate(rig(n)):
        Image.fromarray(photograph(view)).save(folder / f"room{k}.jpg", quality=95, exif=exif_of())
    return folder
