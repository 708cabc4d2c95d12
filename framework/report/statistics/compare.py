"""Compare two methods over runs paired by scene and seed, for two questions.

*These scenes*: what other seeds would give on the same scenes. The same seed on several scenes
shares its random draws, so its pairs are not independent. The differences of a seed are averaged
over the scenes first, and the t interval is over seeds. Seeds that lack a scene are left out. If
fewer than two seeds would remain, scenes with few seeds are left out instead (`block`).

*Scenes like these*: what other scenes of the same kind would give. The differences of a scene are
averaged over its seeds first, and the t interval is over scenes, so it is wide with few scenes.
Conditions of one scene, such as other photos of it or wrong poses, are not independent scenes, so
they are averaged to one value too.
"""

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
    """The difference of `method` to `baseline` in dB.

    Attributes:
        scenes: the scenes of `these`.
        these: estimate over the seeds; over no seed if no seed is on all scenes.
        like: estimate over all scenes of both, conditions of one scene averaged; None for one
            scene.
        tests: how many comparisons `joint`, `p_joint` and `significant` are corrected for.
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
        """The interval of this comparison alone, without correction."""
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
    """Compare over the pairs that both methods have; None if there is none.

    Args:
        names: the common name of scenes that are conditions of one scene. By default each scene is
            separate.
    """
    keys = sorted(values.keys() & others.keys())
    if not keys:
        return None
    differences = {key: values[key] - others[key] for key in keys}
    every = sorted({scene for scene, _ in keys})
    by_scene = [
        float(np.mean([d for (other, _), d in differences.items() if other == scene]))
        for scene in every
    ]
    scenes, seeds = block(keys)
    by_seed = [float(np.mean([differences[scene, seed] for scene in scenes])) for seed in seeds]
    these = estimate(by_seed) if by_seed else Estimate(0, float(np.mean(by_scene)), None)
    by_name: dict[str, list[float]] = defaultdict(list)
    for scene, mean in zip(every, by_scene, strict=True):
        by_name[(names or {}).get(scene, scene)].append(mean)
    like = (
        estimate([float(np.mean(means)) for means in by_name.values()])
        if len(by_name) > 1
        else None
    )
    return Comparison(method, baseline, tuple(scenes), these, like)


def block(keys: Collection[tuple[K, int]]) -> tuple[list[K], list[int]]:
    """Choose pairs (place, seed) so that every place has the same seeds.

    These are all places with their common seeds. If fewer than two seeds remain, they are places
    that share two or more seeds, chosen greedily to keep many pairs, if there are any.
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
