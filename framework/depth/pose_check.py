"""Check by stereo that poses and photos belong together, before any training.

With right poses, depth maps of neighbouring photos confirm each other far more often than by
chance. Chance is measured with the same cameras and the photos exchanged among them, because
smooth areas confirm each other there too. The check works on small copies of the photos, so it is
cheap and does not depend on the depth provider.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import torch

from framework.depth.options import PlaneSweepOptions
from framework.errors import UserError
from framework.types import TrainingSet, View

LIMIT = 1.22  # between sound set-ups (1.256 and more) and wrong ones: benchmarks/results
SIDE = 200  # pixels: photos are reduced to about this longer side
MOST_VIEWS = 12  # more are thinned out evenly
FLOOR = 0.2  # added to both supports, so that two tiny ones have a ratio near 1
OPTIONS = PlaneSweepOptions(planes=64, neighbours=3, tolerance=0.015)


@dataclass(frozen=True)
class PoseCheck:
    """How far photos confirm each other's depth, and what would fit if they do not.

    Attributes:
        support: mean confidence of the depth with the photos as given, in [0, 1].
        chance: the same with the photos exchanged among the cameras, mean over the exchanges.
        cause: the likely cause of poses that do not fit, with its remedy; "" if none was found.
    """

    support: float
    chance: float
    cause: str = ""

    @property
    def ratio(self) -> float:
        """Evidence for the poses: about 1 if they do not fit, 1.26 to 3 if they do."""
        return (self.support + FLOOR) / (self.chance + FLOOR)

    @property
    def fits(self) -> bool:
        return self.ratio >= LIMIT

    def figures(self) -> dict[str, float | bool]:
        """Return the numbers for a run's record."""
        numbers = {"support": self.support, "chance": self.chance, "ratio": self.ratio}
        return {**{name: round(value, 3) for name, value in numbers.items()}, "fits": self.fits}

    def warning(self) -> str:
        """Format a one-line warning about poses that do not fit."""
        advice = self.cause or (
            "check the axes of the poses, the order and orientation of the photos and the depth"
            " bounds; photos without much overlap give the same warning"
        )
        return (
            "the poses do not seem to fit the photos: stereo confirms little more than with the"
            f" photos exchanged (ratio {self.ratio:.2f}, expected {LIMIT} or more); {advice}"
        )


def check_poses(
    training: TrainingSet, remedies: Sequence[tuple[str, Callable[[TrainingSet], TrainingSet]]] = ()
) -> PoseCheck | None:
    """Compare how often photos confirm each other's depth with chance.

    Args:
        training: the photos and cameras as loaded.
        remedies: (cause and remedy in words, the repaired training set); tried if the check fails.

    Returns:
        The check, or None where nothing can be compared: fewer than two photos of one size, or
        no two views that overlap.
    """
    small = _reduced(training)
    check = _measured(small)
    if check is None or check.fits:
        return check
    repaired = [(cause, _measured(repair(small))) for cause, repair in remedies]
    fitting = [(other.ratio, cause) for cause, other in repaired if other and other.fits]
    return replace(check, cause=max(fitting)[1]) if fitting else check


def _measured(training: TrainingSet) -> PoseCheck | None:
    """The check of a small training set."""
    support = _support(training)
    chances = [c for c in map(_support, _exchanged(training)) if c is not None]
    if support is None or not chances:
        return None
    return PoseCheck(support, sum(chances) / len(chances))


def _reduced(training: TrainingSet) -> TrainingSet:
    """Small copies of up to `MOST_VIEWS` photos of the most common size (photos of different sizes
    cannot be exchanged)."""
    sizes = Counter((v.camera.width, v.camera.height) for v in training.views)
    size = sizes.most_common(1)[0][0]
    same = [i for i, v in enumerate(training.views) if (v.camera.width, v.camera.height) == size]
    step = max(1.0, len(same) / MOST_VIEWS)
    chosen = [same[int(k * step)] for k in range(min(len(same), MOST_VIEWS))]
    factor = max(1, round(max(size) / SIDE))
    views = tuple(_small(training.views[i], factor) for i in chosen)
    points = replace(training.points, visible=training.points.visible[:, chosen])
    return replace(training, views=views, points=points)


def _small(view: View, factor: int) -> View:
    def pooled(image: torch.Tensor) -> torch.Tensor:
        return torch.nn.functional.avg_pool2d(image, factor)

    mask = None if view.mask is None else (pooled(view.mask[None])[0] > 0.5).float()
    camera = view.camera.scaled(factor)
    return replace(view, camera=camera, image=pooled(view.image), mask=mask, depth=None)


def _exchanged(training: TrainingSet) -> Iterator[TrainingSet]:
    """Every camera with the photo and mask of the next view; with three or more also of the one
    after."""
    views = training.views
    for shift in (1, 2)[: len(views) - 1]:
        others = [*views[shift:], *views[:shift]]
        exchanged = [
            replace(v, image=o.image, mask=o.mask) for v, o in zip(views, others, strict=True)
        ]
        yield replace(training, views=tuple(exchanged))


def _support(training: TrainingSet) -> float | None:
    """The mean confidence of the views' depth, None without overlap."""
    from framework.depth.matching.sweep import sweep_views

    try:
        maps = sweep_views(training, OPTIONS)
    except UserError:
        return None
    return sum(float(m.confidence.mean()) for m in maps) / len(maps)
