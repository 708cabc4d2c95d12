"""Two methods compared over runs paired by (scene, seed), with two intervals.

*These scenes*: the effect for other seeds on the same scenes. Pairs of one seed on several scenes
are not independent. The differences of a seed are therefore averaged over the scenes, and the t
interval is over the seeds. Seeds that lack a scene are left out. If fewer than two remain, scenes
with few seeds are left out instead (`block`).

*Scenes like these*: the effect for other scenes of the same kind. The differences of a scene are
averaged over its seeds, and the t interval is over the scenes. Conditions of one scene, such as
other training photos or wrong poses, are averaged to one value.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from framework.report.statistics.estimates import Estimate, Interval, estimate
from framework.report.study.methods import Method

Pairs = Mapping[tuple[str, int], float]  # (scene, seed) -> PSNR in dB
M = TypeVar("M")
K = TypeVar("K", str, int)  # a scene, or the place of a strength among those of a stress


@dataclass(frozen=True)
class Comparison:
    """`method` minus `baseline` in dB.

    Attributes:
        scenes: the scenes of `these`.
        these: over the seeds; without values if no seed is on all scenes.
        like: over all common scenes, conditions of one scene averaged; None for a single scene.
        tests: number of comparisons that `joint`, `p_joint` and `significant` are corrected for.
    """

    method: Method
    baseline: Method
    scenes: tuple[str, ...]
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
        """The interval of this comparison alone."""
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


def compare(
    method: Method,
    values: Pairs,
    baseline: Method,
    others: Pairs,
    names: Mapping[str, str] | None = None,
) -> Comparison | None:
    """Compare over common pairs; None if there is none.

    Args:
        names: scene of each condition; without it every scene counts by itself.
    """
    keys = sorted(values.keys() & others.keys())
    if not keys:
        return None
    found = {key: values[key] - others[key] for key in keys}
    every = sorted({scene for scene, _ in keys})
    by_scene = [
        float(np.mean([d for (other, _), d in found.items() if other == scene])) for scene in every
    ]
    scenes, seeds = block(keys)
    by_seed = [float(np.mean([found[scene, seed] for scene in scenes])) for seed in seeds]
    these = estimate(by_seed) if by_seed else Estimate(0, float(np.mean(by_scene)), None)
    by_name: dict[str, list[float]] = defaultdict(list)
    for scene, mean in zip(every, by_scene, strict=True):
        by_name[(names or {}).get(scene, scene)].append(mean)
    like = estimate([float(np.mean(own)) for own in by_name.values()]) if len(by_name) > 1 else None
    return Comparison(method, baseline, tuple(scenes), these, like)


def block(keys: Collection[tuple[K, int]]) -> tuple[list[K], list[int]]:
    """Choose pairs (place, seed) so that every place has every seed.

    All places with their common seeds; if these are fewer than two, a greedy choice of places that
    share at least two seeds and keep many pairs.
    """
    seeds: dict[K, set[int]] = defaultdict(set)
    for place, seed in keys:
        seeds[place].add(seed)
    order = sorted(seeds)
    common = set.intersection(*seeds.values())
    if len(common) > 1:
        return order, sorted(common)
    size, best = (0, 0), (order, sorted(common))
    for first in order:  # with it, those places that cost the fewest of its seeds
        kept = seeds[first]
        for place in sorted(order, key=lambda p: -len(seeds[p] & seeds[first])):
            kept = kept & seeds[place]
            inside = [p for p in order if seeds[p] >= kept]
            if len(kept) > 1 and (len(kept) * len(inside), len(inside)) > size:
                size, best = (len(kept) * len(inside), len(inside)), (inside, sorted(kept))
    return best


def corrected(comparisons: Mapping[M, Comparison]) -> dict[M, Comparison]:
    """Correct intervals and p for all comparisons that can be tested, over seeds or scenes."""
    testable = [
        c for c in comparisons.values() if c.p is not None or (c.like and c.like.p is not None)
    ]
    tests = max(1, len(testable))
    return {method: replace(c, tests=tests) for method, c in comparisons.items()}
