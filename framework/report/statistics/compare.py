"""Two methods over runs paired by (scene, seed): two questions, two answers.

*These scenes*: what another draw of the seeds would give on them. The same seed on several scenes
shares its draws, so pairs of one seed are not independent: the differences of a seed are averaged
over the scenes first, and the t interval is over the seeds, one value each. Seeds that lack a scene
are left out.

*Scenes like these*: what other scenes of their kind would give. The differences of a scene are
averaged over its seeds first, and the t interval is over the scenes, one value each: with few
scenes it is wide, as it should be.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from framework.report.statistics.estimates import Estimate, Interval, estimate

Pairs = Mapping[tuple[str, int], float]  # (scene, seed) -> PSNR in dB


@dataclass(frozen=True)
class Comparison:
    """`method` minus `baseline` in dB. scenes, pairs: how many both have. these: over the seeds, of
    no seed where none is on all scenes. like: over the scenes, None for a single one. tests: how
    many comparisons `joint`, `p_joint` and `significant` are corrected for."""

    method: str
    baseline: str
    scenes: int
    pairs: int
    these: Estimate
    like: Estimate | None
    tests: int = 1

    @property
    def difference(self) -> float:
        return self.these.mean

    @property
    def n(self) -> int:
        """The number of seeds."""
        return self.these.n

    @property
    def p(self) -> float | None:
        return self.these.p

    @property
    def interval(self) -> Interval | None:
        """Of this comparison alone."""
        return self.these.interval()

    @property
    def joint(self) -> Interval | None:
        """The interval that holds for all of the `tests` at once."""
        return self.these.interval(self.tests)

    @property
    def like_joint(self) -> Interval | None:
        """The same for scenes like these."""
        return None if self.like is None else self.like.interval(self.tests)

    @property
    def p_joint(self) -> float | None:
        return None if self.p is None else min(1.0, self.tests * self.p)

    @property
    def significant(self) -> bool:
        """Whether the corrected interval, which charts draw, excludes zero."""
        return excludes_zero(self.joint)

    @property
    def general(self) -> bool:
        """Whether both do, that of these scenes and that of scenes like these."""
        return self.significant and excludes_zero(self.like_joint)


def excludes_zero(interval: Interval | None) -> bool:
    """False without an interval."""
    return interval is not None and not interval.low <= 0 <= interval.high


def compare(method: str, values: Pairs, baseline: str, others: Pairs) -> Comparison | None:
    """Over the pairs both have; None if there is none."""
    keys = sorted(values.keys() & others.keys())
    if not keys:
        return None
    found = {key: values[key] - others[key] for key in keys}
    scenes = sorted({scene for scene, _ in keys})
    by_scene = [
        float(np.mean([d for (other, _), d in found.items() if other == scene])) for scene in scenes
    ]
    by_seed = [
        float(np.mean([found[scene, seed] for scene in scenes]))
        for seed in sorted({seed for _, seed in keys})
        if all((scene, seed) in found for scene in scenes)
    ]
    these = estimate(by_seed) if by_seed else Estimate(0, float(np.mean(by_scene)), None)
    like = estimate(by_scene) if len(scenes) > 1 else None
    return Comparison(method, baseline, len(scenes), len(keys), these, like)


def corrected(known: Mapping[str, Comparison]) -> dict[str, Comparison]:
    """With intervals and p that hold for all of those that can be tested at once."""
    tests = max(1, sum(c.p is not None for c in known.values()))
    return {method: replace(c, tests=tests) for method, c in known.items()}
