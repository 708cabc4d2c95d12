"""Split protocols: which of a scene's images train and which test. Named, so that results say it.

`llff`: file names sorted; test = every 8th, starting with the first (the LLFF convention of NeRF
and Mip-NeRF 360); training = the rest, of which n_views are taken at the indices
`round(linspace(0, n - 1, n_views))` (RegNeRF, Niemeyer et al. 2022; so do FSGS, DropGaussian and
CoR-GS). Ties round to even, as in numpy.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from framework.errors import UserError, nearest_hint, require


@dataclass(frozen=True)
class Split:
    """Indices into the *sorted* names, ascending."""

    train: tuple[int, ...]
    test: tuple[int, ...]


@dataclass(frozen=True)
class Protocol:
    """A named rule. divide(n) -> (pool for training, test) of n sorted names."""

    name: str
    source: str
    divide: Callable[[int], tuple[list[int], list[int]]]

    def split(self, names: Sequence[str], n_views: int, where: str) -> Split:
        """The split of `names` (sorted) with n_views training views; `where` opens the error."""
        require(list(names) == sorted(names), f"{where}: split protocols need sorted names")
        pool, test = self.divide(len(names))
        if n_views > len(pool):
            raise UserError(
                f"{where}: expected n_views of at most {len(pool)} ({len(names)} images, of which"
                f" split={self.name} keeps {len(test)} for testing), got {n_views}; lower n_views"
            )
        return Split(tuple(pool[i] for i in _spaced(len(pool), n_views)), tuple(test))


def _spaced(n: int, count: int) -> list[int]:
    """`round(linspace(0, n - 1, count))`."""
    import numpy as np

    return [int(i) for i in np.round(np.linspace(0, n - 1, count))]


def _every_eighth(n: int) -> tuple[list[int], list[int]]:
    return [i for i in range(n) if i % 8], [i for i in range(n) if i % 8 == 0]


PROTOCOLS: dict[str, Protocol] = {
    p.name: p
    for p in (
        Protocol("llff", "NeRF's every-8th test views, RegNeRF's rounded linspace", _every_eighth),
    )
}


def protocol(name: str) -> Protocol:
    """The protocol of that name. Raises UserError listing the known ones."""
    if name not in PROTOCOLS:
        raise UserError(f"split={name}: unknown protocol; {nearest_hint(name, PROTOCOLS)}")
    return PROTOCOLS[name]
