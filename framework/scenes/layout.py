"""What the loaders of a scene's folder share: options, their checks, and the way from listed photos
to a scene."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from framework.errors import require
from framework.scenes.assemble import Tracks, assemble
from framework.scenes.conventions import CONVENTIONS
from framework.scenes.images import AUTO, scene_folder
from framework.scenes.photo import Photo, check_content, read_shots
from framework.scenes.points import points_and_bounds
from framework.scenes.splits import ALL, FILES, Split, protocol

if TYPE_CHECKING:
    from framework.types import Scene


@dataclass(frozen=True)
class Listing:
    """The photos of a scene as its files list them, with poses.

    Attributes:
        where: starts a message.
        viewmats: [4, 4] world-to-camera of all photos, in the order of their names or files.
        photo_at: index of a photo -> the photo; only those of the split are asked for.
        split: indices of photos.
        tracks: sparse points, `seen` over all photos.
        near, far: depth bounds, None to find them from the points.
        paper: grey value 0 to 255 behind transparent photos; None masks transparent pixels.
        points_train: whether training gets the points, which else only give the bounds.
    """

    name: str
    where: str
    viewmats: Sequence[NDArray[np.float64]]
    photo_at: Callable[[int], Photo]
    split: Split
    tracks: Tracks
    near: float | None
    far: float | None
    paper: int | None = None
    points_train: bool = True


@dataclass(frozen=True)
class FolderScene:
    """A scene in a folder.

    Attributes:
        near, far: depth bounds in scene units; null = from the points. Depth is searched between
            those that differ from the layout's defaults.
    """

    layout: ClassVar[str]
    splits_by_file: ClassVar[bool] = False  # whether the scene's files may define the split
    least_downscale: ClassVar[int] = 1

    path: str  # folder of the scene
    n_views: int | str = 12  # training views; all = every one that is not for testing
    downscale: int | None = 1  # photos are reduced by it, averaging boxes of pixels
    near: float | None = None
    far: float | None = None
    split: str = "llff"  # which views train and which test: llff, mip360, dtu; none = no test

    def __post_init__(self) -> None:
        self.expect(
            isinstance(self.path, str) and self.path != "",
            f"the scene's folder, got '{self.path}'; give scene.path=DIR",
        )
        check_n_views(self.layout, self.n_views, all_too=True)
        self.expect(
            self.downscale is None or self.downscale >= self.least_downscale,
            f"downscale to be an integer >= 1, got {self.downscale}; 1 keeps the photos' size",
        )
        if not (self.splits_by_file and self.split in FILES):
            protocol(self.split)
        for option, what in (("images", "photos"), ("model", "COLMAP model")):
            name = getattr(self, option, AUTO)
            self.expect(
                isinstance(name, str) and name != "",
                f"the folder of the {what}, got '{name}'; set scene.{option}",
            )
        bounds = [bound for bound in (self.near, self.far) if bound is not None]
        self.expect(
            all(0 < bound < math.inf for bound in bounds) and bounds == sorted(set(bounds)),
            f"0 < near < far, got near={self.near}, far={self.far}; correct one of them",
        )
        self.expect_choice("poses", CONVENTIONS)

    def expect(self, good: bool, what: str) -> None:
        """Raise UserError, with what was expected, unless `good`."""
        require(good, f"scene={self.layout}: expected {what}")

    def expect_choice(self, option: str, choices: Sequence[str]) -> None:
        """Raise UserError unless the option, if there is one, is among `choices`."""
        value = getattr(self, option, choices[0])
        self.expect(
            value in choices,
            f"{option} to be one of {', '.join(choices)}, got '{value}'; set scene.{option}",
        )

    def load(self) -> Scene:
        """Load the scene.

        Raises:
            UserError: if the folder lacks a part of the layout, or its files do not fit together.
        """
        return load_listed(self, self.listing(scene_folder(self.layout, self.path)))

    def listing(self, folder: Path) -> Listing:
        """List the photos of the scene in `folder`.

        Raises:
            UserError: as `load`.
        """
        raise NotImplementedError

    def usual_downscale(self, photo: Path) -> int:
        """The factor for such photos if `downscale` is not set."""
        return 1


def load_listed(options: FolderScene, listed: Listing) -> Scene:
    """Read the photos and choose the points.

    Raises:
        UserError: if they do not fit together.
    """
    downscale = options.downscale
    if downscale is None:
        downscale = options.usual_downscale(listed.photo_at(0).file)
    train, test = read_shots(listed.photo_at, listed.split, downscale, listed.paper)
    check_content(train, listed.where)
    tracks, near, far = points_and_bounds(
        listed.tracks,
        listed.viewmats,
        listed.split.train,
        train,
        listed.near,
        listed.far,
        listed.where,
    )
    tracks = tracks if listed.points_train else Tracks()
    paper = None if listed.paper is None else listed.paper / 255
    given = (options.near != type(options).near, options.far != type(options).far)
    return assemble(listed.name, options.split, train, test, tracks, near, far, paper, given)


def check_n_views(loader: str, n_views: int | str, all_too: bool = False) -> None:
    """Check for a positive integer; `all_too` also allows `all`."""
    require(
        (type(n_views) is int and n_views >= 1) or (all_too and n_views == ALL),
        f"scene={loader}: expected n_views to be an integer >= 1{f' or {ALL}' if all_too else ''},"
        f" got {n_views!r}; set scene.n_views",
    )
