"""Renders as 8-bit pictures: colour, depth, or both side by side.

Depth is drawn as its inverse in the colour map `turbo` (Mikhailov 2019), red is near and blue is
far. The range is the same for all pictures of a command. Empty pixels are black.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, TextIO

from framework.compute.stopwatch import duration
from framework.records.progress import Line

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from framework.exports.opened import OpenedRun
    from framework.types import Camera

SHARES = (0.02, 0.98)  # quantiles of the depths, the ends of the colour map
LOOKED_AT = 9  # cameras whose depths are used


@dataclass(frozen=True)
class Painter:
    """Draws `shown` (rgb, depth, both) from any camera.

    Attributes:
        near, far: range of the colour map.
    """

    run: OpenedRun
    shown: str
    near: float = 0.0
    far: float = 0.0

    def picture(self, camera: Camera) -> NDArray[np.uint8]:
        """[H, W, 3], or [H, 2 W, 3] for both."""
        import numpy as np

        from framework.metrics.evaluate import quantise

        render = self.run.render(camera, depth=self.shown != "rgb")
        parts = [] if self.shown == "depth" else [quantise(render.rgb)]
        if self.shown != "rgb":
            alpha = render.alpha.numpy()
            parts.append(coloured(render.expected_depth.numpy(), alpha, self.near, self.far))
        return np.concatenate(parts, axis=1)


def painter(run: OpenedRun, shown: str, cameras: Sequence[Camera]) -> Painter:
    """A painter whose colour map suits all cameras."""
    import numpy as np

    if shown == "rgb":
        return Painter(run, shown)
    visible = []
    for index in np.linspace(0, len(cameras) - 1, min(LOOKED_AT, len(cameras))).round():
        render = run.render(cameras[int(index)], depth=True)
        depth, solid = render.expected_depth.numpy(), render.alpha.numpy() > 0.5
        visible.append(depth[solid & (depth > 0)][::7])
    depths = np.concatenate(visible)
    if not len(depths):
        return Painter(run, shown, 1.0, 2.0)
    near, far = (float(d) for d in np.quantile(depths, SHARES))
    return Painter(run, shown, near, max(far, near * 1.001))


def coloured(
    depth: NDArray[np.float32], alpha: NDArray[np.float32], near: float, far: float
) -> NDArray[np.uint8]:
    """Colours [H, W, 3] of the depth [H, W] in scene units, darkened by alpha [H, W]."""
    import cv2
    import numpy as np

    inverse = 1 / np.maximum(depth, 1e-9)
    share = (inverse - 1 / far) / (1 / near - 1 / far)
    level = np.rint(255 * np.clip(share, 0, 1)).astype(np.uint8)
    colours = cv2.applyColorMap(level, cv2.COLORMAP_TURBO)[..., ::-1]
    return np.rint(colours * alpha[..., None].clip(0, 1)).astype(np.uint8)


PERIOD_S = {True: 0.2, False: 10.0}  # on a terminal, and elsewhere


class Ticks:
    """Prints progress and the time left.

    Args:
        what: the items, as in `frames`.
    """

    def __init__(self, what: str, stream: TextIO | None = None) -> None:
        self._what, self._line = what, Line(sys.stderr if stream is None else stream)
        self._started = self._printed_at = time.monotonic()

    def __call__(self, done: int, total: int) -> None:
        now = time.monotonic()
        if done < total and now - self._printed_at < PERIOD_S[self._line.in_place]:
            return
        self._printed_at = now
        left = (now - self._started) / done * (total - done) if done else 0.0
        rest = f", {duration(left)} left" if left >= 1 else ""
        show = self._line.show if done < total else self._line.keep
        show(f"{done} of {total} {self._what}{rest}")
