"""Lens distortion and its removal: training gets every photo as a pinhole would have taken it.

The model is OpenCV's (its calib3d documentation). With x, y in units of the focal length from the
principal point and r^2 = x^2 + y^2:

    x_distorted = x q + 2 p1 x y + p2 (r^2 + 2 x^2)
    y_distorted = y q + p1 (r^2 + 2 y^2) + 2 p2 x y
    q = (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6)

COLMAP's FULL_OPENCV cameras use it. SIMPLE_RADIAL, RADIAL and OPENCV are special cases.
"""

from dataclasses import astuple, dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Distortion:
    """Radial (k) and tangential (p) coefficients; all 0 is a pinhole."""

    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0
    k5: float = 0.0
    k6: float = 0.0

    @property
    def terms(self) -> tuple[float, ...]:
        """The fields in order, without k4, k5 and k6 if all of these are 0."""
        values = astuple(self)
        return values if any(values[5:]) else values[:5]


PINHOLE = Distortion()


@dataclass(frozen=True)
class Lens:
    """Intrinsics of a photo of width x height: focal lengths and principal point in pixels."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: Distortion = PINHOLE


def distorted_pixels(
    height: int, width: int, K: NDArray[np.float64], lens: Distortion
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """Map the pixels of a pinhole camera to the stored, distorted photo.

    Returns:
        u, v: [H, W] in pixels with centres at +0.5; and whether the radial model is monotonic
        there, [H, W].
    """
    x = (np.arange(width) + 0.5 - K[0, 2]) / K[0, 0]
    y = ((np.arange(height) + 0.5 - K[1, 2]) / K[1, 1])[:, None]
    r2 = x * x + y * y
    top = 1.0 + r2 * (lens.k1 + r2 * (lens.k2 + r2 * lens.k3))
    bottom = 1.0 + r2 * (lens.k4 + r2 * (lens.k5 + r2 * lens.k6))
    radial = top / bottom
    # d/dr (r top / bottom) times bottom^2
    slope = 1.0 + r2 * (3 * lens.k1 + r2 * (5 * lens.k2 + r2 * 7 * lens.k3))
    slope = slope * bottom - top * r2 * (2 * lens.k4 + r2 * (4 * lens.k5 + r2 * 6 * lens.k6))
    u = x * radial + 2 * lens.p1 * x * y + lens.p2 * (r2 + 2 * x * x)
    v = y * radial + lens.p1 * (r2 + 2 * y * y) + 2 * lens.p2 * x * y
    return K[0, 0] * u + K[0, 2], K[1, 1] * v + K[1, 2], (slope > 0) & (bottom > 0)


def undistort(
    image: NDArray[np.uint8], K: NDArray[np.float64], lens: Distortion
) -> tuple[NDArray[np.uint8], NDArray[np.float32] | None]:
    """Resample the photo [H, W, 3] as a pinhole K would have taken it.

    Interpolates over 8 x 8 pixels (Lanczos), which keeps detail. A bilinear filter removes detail
    that is hard to predict: test photos then score more than 1 dB higher on LLFF fern, even with a
    wrong lens (`benchmarks/results/lens.md`).

    Returns:
        The image, and the mask [H, W] of the pixels that the photo covers, None if it covers all.
    """
    import cv2

    height, width = image.shape[:2]
    u, v, single = distorted_pixels(height, width, K, lens)
    straight = cv2.remap(
        image,
        (u - 0.5).astype(np.float32),  # OpenCV counts pixel centres from 0
        (v - 0.5).astype(np.float32),
        cv2.INTER_LANCZOS4,
        borderMode=cv2.BORDER_REPLICATE,
    )
    # a pixel's own area reaches half a pixel beyond the outermost centres
    valid = single & (u >= 0) & (u <= width) & (v >= 0) & (v <= height)
    out = np.ascontiguousarray(straight, dtype=np.uint8)
    return out, None if valid.all() else valid.astype(np.float32)
