"""Two methods over runs paired by (scene, seed): two questions, two answers.

*These scenes*: what another draw of the seeds would give on them. The same seed on several scenes
shares its draws, so pairs of one seed are not independent: the differences of a seed are averaged
over the scenes first, and the t interval is over the seeds, one value each. Seeds that lack a scene
are left out; where fewer than two would stay, scenes with few seeds are (`block`).

*Scenes like these*: what other scenes of their kind would give. The differences of a scene are
averaged over its seeds first, and the t interval is over the scenes, one value each: with few
scenes it is wide, as it should be. Conditions of one scene, such as other photos of it or wrong
poses, tell nothing of other scenes: they are averaged to one value too.
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
    """`method` minus `baseline` in dB. scenes: those that `these` is about. these: over the seeds,
    of no seed where none is on all scenes. like: over all scenes of both, conditions of one scene
    taken together; None for a single one. tests: how many comparisons `joint`, `p_joint` and
    `significant` are corrected for."""

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


def compare(
    method: Method,
    values: Pairs,
    baseline: Method,
    others: Pairs,
    names: Mapping[str, str] | None = None,
) -> Comparison | None:
    """Over the pairs both have; None if there is none. names: of scenes that are conditions of one,
    its name; without it each scene is one of its own."""
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
    """Of pairs (place, seed): all places with the seeds that each has. Where these are fewer than
    two, places that share two seeds or more, so that many pairs stay (found place by place, not by
    trying all), if there are any."""
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
    """With intervals and p that hold for all of those that can be tested at once, over seeds or
    over scenes."""
    testable = [
        c for c in comparisons.values() if c.p is not None or (c.like and c.like.p is not None)
    ]
    tests = max(1, len(testable))
    return {method: replace(c, tests=tests) for method, c in comparisons.items()}
