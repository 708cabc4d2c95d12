"""Split protocols: which of a scene's images train and which test. Named, so that results say it.

`llff`: file names sorted; test = every 8th, starting with the first (the LLFF convention of NeRF
and Mip-NeRF 360); training = the rest, of which n_views are taken at the indices
`round(linspace(0, n - 1, n_views))` (RegNeRF, Niemeyer et al. 2022; so do FSGS, DropGaussian and
CoR-GS). Ties round to even, as in numpy. The usual counts are 3, 6 and 9.

`mip360`: the same rule; the usual counts are 12 and 24 (FSGS, CoR-GS, DropGaussian). nerfbaselines'
variant truncates instead of rounding and so takes other frames.

`dtu`: the 49 positions of the rig, numbered from 0. Training = the first n_views of 25, 22, 28, 40,
44, 48, 0, 8, 13 (pixelNeRF, Yu et al. 2021; RegNeRF; CoR-GS), usually 3, 6 or 9; test = the 25
positions that are neither among these nine nor among 3-7, 16-21, 36-39, which pixelNeRF's
evaluation leaves out as badly exposed, whatever n_views is.

`blender`: the 100 training and 200 test frames of NeRF's synthetic objects in the order of their
files, numbered from 0. Training = the first n_views of 26, 86, 2, 55, 75, 93, 16, 73, 8 (DietNeRF,
Jain et al. 2021, has the first eight; FreeNeRF, DNGaussian), usually 8; more than nine are evenly
spaced among the 100. Test = every 8th of the 200, starting with the first (25 views).

`none`: every image may train, none tests; n_views are taken of all of them as by `llff`. For the
best model of a scene, of which then nothing is measured.

`llff_held_out`, `mip360_held_out`, `dtu_held_out`, `blender_held_out`: the same training views,
judged on others that may train but do not, six at most and evenly spaced, in place of the test
views, which are not even read. For choosing among settings (`fishersplat search`): test views may
not choose.

`llff_drawn0`, `llff_drawn1`, ... (and so for each of the above, with `_held_out` at the end): the
same test views, but training views drawn at random from all that may train; the number is the
draw's seed. For asking whether an answer depends on which photos one has: a study over draws has
many triples of photos where a protocol has one.

`file` (of `scene=transforms`): as the scene's own file names its test photos, in `test_filenames`
or, where there are none, `val_filenames`; training views by `llff`'s rule, of `train_filenames` or
of all that remain. `file_held_out` judges by others of these. (Of `scene=blender`: as its two files
list them.)

n_views is a number or `all`: as many as the protocol leaves for training.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from os.path import splitext

from framework.errors import UserError, nearest_hint, require

DTU_TRAINING = (25, 22, 28, 40, 44, 48, 0, 8, 13)
DTU_EXCLUDED = (3, 4, 5, 6, 7, 16, 17, 18, 19, 20, 21, 36, 37, 38, 39)
DTU_POSITIONS = 49
BLENDER_TRAINING = (26, 86, 2, 55, 75, 93, 16, 73, 8)
BLENDER_FILES = (100, 200)  # frames for training and testing
ALL = "all"  # as the number of views: every one that the protocol leaves for training
UNTESTED = "none"  # the protocol without test views
FILE = "file"  # the protocol that a scene's own file names
HELD_OUT = "_held_out"  # ends the names of those that judge by training views
FILES = (FILE, f"{FILE}{HELD_OUT}")  # splits that only a file's own words make
DRAWN = "_drawn"  # with a number ends the names of those that draw their training views
MOST_HELD_OUT = 6


@dataclass(frozen=True)
class Split:
    """Indices into the *sorted* names, ascending."""

    train: tuple[int, ...]
    test: tuple[int, ...]


@dataclass(frozen=True)
class Protocol:
    """A named rule. divide(n) -> (pool for training, test) of n sorted names;
    pick(pool, n_views) -> training. images: how many there must be, where that is fixed. held_out:
    judge by views of the pool that do not train."""

    name: str
    source: str
    divide: Callable[[int], tuple[list[int], list[int]]]
    pick: Callable[[list[int], int], list[int]]
    images: int | None = None
    held_out: bool = False

    def split(
        self,
        names: Sequence[str],
        n_views: int | str,
        where: str,
        missing: Collection[int] = (),
    ) -> Split:
        """The split of `names` (sorted) with n_views training views, a number or `ALL`; `where`
        opens the error. missing: indices of views that have a name but no photo."""
        require(list(names) == sorted(names), f"{where}: split protocols need sorted names")
        require(
            self.images in (None, len(names)),
            f"{where}: expected {self.images} images for scene.split={self.name}, got {len(names)};"
            " restore the missing ones or choose another scene.split",
        )
        pool, test = ([i for i in part if i not in missing] for part in self.divide(len(names)))
        require(
            bool(test) or not self.divide(len(names))[1],
            f"{where}: expected test photos for scene.split={self.name}, but all are missing;"
            " restore them or choose another scene.split",
        )
        count = len(pool) if n_views == ALL else int(n_views)
        require(
            count > 0,
            f"{where}: expected a photo to train on, got none of {len(names)}: scene.split="
            f"{self.name} keeps {len(test)} for testing; scene.split=none trains on all",
        )
        if count > len(pool):
            raise UserError(
                f"{where}: expected n_views of at most {len(pool)} ({len(names)} images, of which"
                f" scene.split={self.name} keeps {len(test)} for testing), got {n_views}; lower"
                " n_views"
            )
        require(
            DRAWN not in self.name or count < len(pool),
            f"{where}: expected n_views below {len(pool)}, the views that may train, for"
            f" scene.split={self.name} to draw from, got {n_views}: every draw would be the same;"
            " set scene.n_views",
        )
        train = sorted(self.pick(pool, count))
        if self.held_out:
            others = [i for i in pool if i not in train]
            require(
                len(others) > 0,
                f"{where}: expected a view that is neither trained on nor tested on for"
                f" scene.split={self.name}, got none of {len(names)}; lower n_views",
            )
            test = _spaced(others, min(len(others), MOST_HELD_OUT))
        return Split(tuple(train), tuple(test))


def _spaced(pool: list[int], count: int) -> list[int]:
    """Those at `round(linspace(0, n - 1, count))`."""
    import numpy as np

    return [pool[int(i)] for i in np.round(np.linspace(0, len(pool) - 1, count))]


def _first(pool: list[int], count: int) -> list[int]:
    return pool[:count]


def _every_eighth(n: int) -> tuple[list[int], list[int]]:
    return [i for i in range(n) if i % 8], [i for i in range(n) if i % 8 == 0]


def _everything(n: int) -> tuple[list[int], list[int]]:
    return list(range(n)), []


def _dtu(n: int) -> tuple[list[int], list[int]]:
    taken = {*DTU_TRAINING, *DTU_EXCLUDED}
    return list(DTU_TRAINING), [i for i in range(n) if i not in taken]


def _blender(n: int) -> tuple[list[int], list[int]]:
    training, _ = BLENDER_FILES
    return list(range(training)), list(range(training, n, 8))


def _usual(pool: list[int], count: int) -> list[int]:
    """Those that papers take of a rendered object, as far as they are in the pool."""
    usual = [i for i in BLENDER_TRAINING if i in pool]
    return usual[:count] if count <= len(usual) else _spaced(pool, count)


PROTOCOLS: dict[str, Protocol] = {
    p.name: p
    for p in (
        Protocol(
            "llff",
            "NeRF's every-8th test views, RegNeRF's rounded linspace",
            _every_eighth,
            _spaced,
        ),
        Protocol(
            "mip360",
            "Mip-NeRF 360's every-8th test views, FSGS's rounded linspace",
            _every_eighth,
            _spaced,
        ),
        Protocol(
            "dtu",
            "pixelNeRF's nine training views and RegNeRF's 25 test views of DTU's 49",
            _dtu,
            _first,
            images=DTU_POSITIONS,
        ),
        Protocol(
            "blender",
            "DietNeRF's eight training views and every 8th of NeRF's 200 test views",
            _blender,
            _usual,
            images=sum(BLENDER_FILES),
        ),
        Protocol(
            UNTESTED, "all views train, rounded linspace; nothing is tested", _everything, _spaced
        ),
    )
}
PROTOCOLS |= {
    f"{p.name}{HELD_OUT}": replace(
        p,
        name=f"{p.name}{HELD_OUT}",
        source=f"{p.source}; judged on views of the training pool that do not train",
        held_out=True,
    )
    for p in [*PROTOCOLS.values()]
    if p.name != UNTESTED
}


def told(
    names: Sequence[str], train: Collection[str], test: Collection[str], split: str = FILE
) -> Protocol:
    """`FILE`, or that with `HELD_OUT`: of the sorted `names` those in `test` test; those in
    `train`, or all others where none are named, may train. Both may lack the suffix."""

    def among(these: Collection[str]) -> list[int]:
        own = [{name, splitext(name)[0]} for name in names]
        return [i for i, both in enumerate(own) if not both.isdisjoint(these)]

    tests = among(test)
    pool = [i for i in (among(train) if train else range(len(names))) if i not in tests]
    source = "the test photos that the scene's file names"
    return Protocol(
        split, source, lambda n: (pool, tests), _spaced, held_out=split.endswith(HELD_OUT)
    )


def _drawn(rule: Protocol, name: str, seed: int) -> Protocol:
    """`rule` under that name with training views drawn from its pool by `seed`."""

    def pick(pool: list[int], count: int) -> list[int]:
        import numpy as np

        return [int(i) for i in np.random.default_rng(seed).permutation(pool)[:count]]

    return replace(
        rule,
        name=name,
        source=f"{rule.source}; training views drawn from the pool with seed {seed}",
        pick=pick,
    )


def untested(name: str) -> bool:
    """Whether a rule keeps no view for testing."""
    return name.partition(DRAWN)[0] == UNTESTED


def published_split(name: str) -> bool:
    """Whether papers judge by it: not by lot, not by held-out views, not without a test, not as one
    file says."""
    return not (untested(name) or DRAWN in name or name.endswith(HELD_OUT) or name == FILE)


def protocol(name: str) -> Protocol:
    """The protocol of that name. Raises UserError listing the known ones."""
    found = re.fullmatch(rf"(.+){DRAWN}(0|[1-9][0-9]{{0,8}})({HELD_OUT})?", str(name), re.ASCII)
    rule = found and f"{found[1]}{found[3] or ''}"
    if found and rule in PROTOCOLS and HELD_OUT not in found[1]:
        return _drawn(PROTOCOLS[rule], name, int(found[2]))
    if name not in PROTOCOLS:
        raise UserError(
            f"scene.split={name}: unknown protocol; {nearest_hint(name, PROTOCOLS)}, and each with"
            " _drawn0, _drawn1, ... after its first word (llff_drawn0: training views by lot)"
        )
    return PROTOCOLS[name]
