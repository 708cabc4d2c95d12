"""Renders as 8-bit pictures: colour, depth, or both side by side.

Depth is drawn as its inverse in the colour map `turbo` (Mikhailov 2019), near red and far blue,
between two depths that stay the same for all pictures of a command; where nothing is seen it is
black.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from framework.exports.opened import OpenedRun
    from framework.types import Camera

SHARES = (0.02, 0.98)  # of the pixels; the depths between which colours are told apart
LOOKED_AT = 9  # cameras from which these depths are taken


@dataclass(frozen=True)
class Painter:
    """What `shown` names, from any camera; near, far: depths of the colour map's ends."""

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
    """One whose depth colours suit all of these cameras."""
    import numpy as np

    if shown == "rgb":
        return Painter(run, shown)
    seen = []
    for index in np.linspace(0, len(cameras) - 1, min(LOOKED_AT, len(cameras))).round():
        render = run.render(cameras[int(index)], depth=True)
        depth, solid = render.expected_depth.numpy(), render.alpha.numpy() > 0.5
        seen.append(depth[solid & (depth > 0)][::7])
    depths = np.concatenate(seen)
    if not len(depths):
        return Painter(run, shown, 1.0, 2.0)
    near, far = (float(d) for d in np.quantile(depths, SHARES))
    return Painter(run, shown, near, max(far, near * 1.001))


def coloured(
    depth: NDArray[np.float32], alpha: NDArray[np.float32], near: float, far: float
) -> NDArray[np.uint8]:
    """[H, W, 3] of the depth [H, W] in scene units, darkened by the opacity alpha [H, W]."""
    import cv2
    import numpy as np

    inverse = 1 / np.maximum(depth, 1e-9)
    share = (inverse - 1 / far) / (1 / near - 1 / far)
    level = np.rint(255 * np.clip(share, 0, 1)).astype(np.uint8)
    colours = cv2.applyColorMap(level, cv2.COLORMAP_TURBO)[..., ::-1]
    return np.rint(colours * alpha[..., None].clip(0, 1)).astype(np.uint8)
