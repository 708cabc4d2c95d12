"""The sharpest frames of a video: the best one of each of equally long stretches.

Sharpness is the variance of the Laplacian (Pech-Pacheco et al. 2000), which motion blur lowers.
Frames of one stretch show nearly the same, so their values are comparable.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from framework.errors import UserError, require
from framework.files.limits import check_pixels

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

SHARPNESS_SIDE = 960  # pixels; reducing frames to it suppresses noise
FEWEST = 3


def sharpest_frames(
    video: Path, n: int, folder: Path, tick: Callable[[int, int], None]
) -> list[Path]:
    """Write at most `n` frames as PNG into `folder`, in the order of time.

    Args:
        tick: called with (done, total) for each frame read.

    Raises:
        UserError: for a damaged or too short video.
    """
    import cv2
    import numpy as np

    total = _count(video)
    n = min(n, total)
    best: dict[int, float] = {}
    files = [folder / f"frame{window:05d}.png" for window in range(n)]
    capture = cv2.VideoCapture(str(video), cv2.CAP_FFMPEG)
    for index in range(total):
        good, frame = capture.read()
        if not good:
            break
        window = index * n // total
        sharp = sharpness(np.asarray(frame, np.uint8))
        if sharp > best.get(window, -1.0):
            best[window] = sharp
            cv2.imwrite(str(files[window]), frame, [cv2.IMWRITE_PNG_COMPRESSION, 1])
        tick(index + 1, total)
    capture.release()
    require(
        len(best) >= FEWEST,
        f"{video}: expected a video of at least {FEWEST} frames, got {len(best)}; is it complete?",
    )
    return [files[window] for window in sorted(best)]


def sharpness(frame: NDArray[np.uint8]) -> float:
    """Variance of the Laplacian of the [H, W, 3] BGR frame's brightness."""
    import cv2

    grey = cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY)
    scale = SHARPNESS_SIDE / max(grey.shape)
    if scale < 1:
        grey = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    return float(cv2.Laplacian(grey, cv2.CV_64F).var())


def _count(video: Path) -> int:
    """The number of frames: from the header, else by reading all."""
    import cv2

    capture = cv2.VideoCapture(str(video), cv2.CAP_FFMPEG)
    if not capture.isOpened():
        raise UserError(
            f"{video}: expected a video that OpenCV reads, got a damaged or unknown file; convert"
            " it to MP4 (H.264)"
        )
    width, height = (int(capture.get(p)) for p in (cv2.CAP_PROP_FRAME_WIDTH, 4))
    check_pixels(video, width, height)
    count = int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
    if not 0 < count < 10_000_000:
        count = 0
        while capture.grab():
            count += 1
    capture.release()
    return count
