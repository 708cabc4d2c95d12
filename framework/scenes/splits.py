"""Split protocols: named rules for which images of a scene train and which test.

`llff`: file names sorted; every 8th is a test view, starting with the first (the LLFF convention of
NeRF and Mip-NeRF 360). Of the remaining n images, n_views train, at the indices
`round(linspace(0, n - 1, n_views))` (RegNeRF, Niemeyer et al. 2022; also FSGS, DropGaussian and
CoR-GS). Ties round to even, as in numpy. The usual counts are 3, 6 and 9.

`mip360`: the same rule; the usual counts are 12 and 24 (FSGS, CoR-GS, DropGaussian).
nerfbaselines' variant truncates instead of rounding and so uses other frames.

`dtu`: the 49 positions of the rig, numbered from 0. Training: the first n_views of 25, 22, 28, 40,
44, 48, 0, 8, 13 (pixelNeRF, Yu et al. 2021; RegNeRF; CoR-GS), usually 3, 6 or 9. Test: the 25
positions that are neither among these nine nor among 3-7, 16-21, 36-39, which pixelNeRF excludes
as badly exposed.

`blender`: the 100 training and 200 test frames of NeRF's synthetic objects in the order of their
files, numbered from 0. Training: the first n_views of 26, 86, 2, 55, 75, 93, 16, 73, 8 (DietNeRF,
Jain et al. 2021, has the first eight; FreeNeRF, DNGaussian), usually 8. More than nine are evenly
spaced among the 100. Test: every 8th of the 200, starting with the first (25 views).

`none`: every image may train and none tests; training views by `llff`'s rule among all images.

`llff_held_out`, `mip360_held_out`, `dtu_held_out`, `blender_held_out`: the same training views.
Test views are at most six others of the training pool, evenly spaced; the real test views are not
read. For choosing settings (`fishersplat search`), which must not use test views.

`llff_drawn0`, `llff_drawn1`, ... (and for the others, with `_held_out` at the end): the same test
views, and training views drawn at random from the pool with this seed. For studies of how results
depend on the choice of photos.

`file` (of `scene=transforms`): the test photos that the scene's file names in `test_filenames` or,
if there are none, in `val_filenames`. Training views by `llff`'s rule, of `train_filenames` or of
all others. `file_held_out` tests on others of these. For `scene=blender`, its two files.

n_views is a number or `all`: as many as the protocol has for training.
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
ALL = "all"  # n_views: all of the training pool
UNTESTED = "none"  # the protocol without test views
FILE = "file"  # the protocol given by a scene's file
HELD_OUT = "_held_out"  # suffix of protocols that test on views of the training pool
FILES = (FILE, f"{FILE}{HELD_OUT}")
DRAWN = "_drawn"  # with a number, suffix of protocols that draw their training views
MOST_HELD_OUT = 6


@dataclass(frozen=True)
class Split:
    """Indices into the *sorted* names, ascending."""

    train: tuple[int, ...]
    test: tuple[int, ...]

    def among(self, kept: Sequence[int]) -> Split:
        """The same images by their places in `kept`, which has all of them."""
        place = {image: k for k, image in enumerate(kept)}
        return Split(tuple(place[i] for i in self.train), tuple(place[i] for i in self.test))


@dataclass(frozen=True)
class Protocol:
    """A named rule.

    Attributes:
        divide: n sorted names -> (training pool, test views).
        pick: (pool, n_views) -> training views.
        images: required number of images, if fixed.
        held_out: test on views of the pool that do not train.
    """

    name: str
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
        """Split sorted `names`.

        Args:
            names: of the images.
            n_views: number of training views, or `ALL`.
            where: starts a message.
            missing: indices of names without a photo.
        """
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
                " scene.n_views"
            )
        require(
            DRAWN not in self.name or count < len(pool),
            f"{where}: expected n_views below {len(pool)}, the views that may train, for"
            f" scene.split={self.name} to draw from, got {n_views}: every draw would be the same;"
            " lower scene.n_views",
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
    """The views at `round(linspace(0, n - 1, count))`."""
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
    """The views that papers use of a rendered object, as far as they are in the pool."""
    usual = [i for i in BLENDER_TRAINING if i in pool]
    return usual[:count] if count <= len(usual) else _spaced(pool, count)


PROTOCOLS: dict[str, Protocol] = {
    rule.name: rule
    for rule in (
        Protocol("llff", _every_eighth, _spaced),
        Protocol("mip360", _every_eighth, _spaced),
        Protocol("dtu", _dtu, _first, images=DTU_POSITIONS),
        Protocol("blender", _blender, _usual, images=sum(BLENDER_FILES)),
        Protocol(UNTESTED, _everything, _spaced),
    )
}
PROTOCOLS |= {
    f"{name}{HELD_OUT}": replace(rule, name=f"{name}{HELD_OUT}", held_out=True)
    for name, rule in PROTOCOLS.items()
    if name != UNTESTED
}


def file_protocol(
    names: Sequence[str], train: Collection[str], test: Collection[str], split: str = FILE
) -> Protocol:
    """The protocol `split`, one of `FILES`.

    Args:
        names: sorted.
        train: names of the training pool, with or without suffix; empty for all others.
        test: names of the test photos, with or without suffix.
    """

    def indices(listed: Collection[str]) -> list[int]:
        return [i for i, name in enumerate(names) if {name, splitext(name)[0]} & {*listed}]

    tests = indices(test)
    pool = [i for i in (indices(train) if train else range(len(names))) if i not in tests]
    held_out = split.endswith(HELD_OUT)
    return Protocol(split, lambda n: (pool, tests), _spaced, held_out=held_out)


def _drawn(rule: Protocol, name: str, seed: int) -> Protocol:
    """`rule` with training views drawn from its pool."""

    def pick(pool: list[int], count: int) -> list[int]:
        import numpy as np

        return [int(i) for i in np.random.default_rng(seed).permutation(pool)[:count]]

    return replace(rule, name=name, pick=pick)


def untested(name: str) -> bool:
    """Whether a protocol has no test views."""
    return name.partition(DRAWN)[0] == UNTESTED


def published_split(name: str) -> bool:
    """Whether papers use it: fixed training views and the usual test views."""
    return not (untested(name) or DRAWN in name or name.endswith(HELD_OUT) or name == FILE)


def protocol(name: str) -> Protocol:
    """The protocol of that name.

    Raises:
        UserError: listing the available ones.
    """
    drawn = re.fullmatch(rf"(.+){DRAWN}(0|[1-9][0-9]{{0,8}})({HELD_OUT})?", str(name), re.ASCII)
    rule = drawn and f"{drawn[1]}{drawn[3] or ''}"
    if drawn and rule in PROTOCOLS and HELD_OUT not in drawn[1]:
        return _drawn(PROTOCOLS[rule], name, int(drawn[2]))
    if name not in PROTOCOLS:
        raise UserError(
            f"scene.split={name}: unknown protocol; {nearest_hint(name, PROTOCOLS)}, and each with"
            " _drawn0, _drawn1, ... after its first word (llff_drawn0: random training views)"
        )
    return PROTOCOLS[name]
