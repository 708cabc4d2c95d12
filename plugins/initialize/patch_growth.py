"""`init=patch_growth`: consistent points, and places around them that all photos confirm.

The growth of points in the code of Binocular-Guided 3DGS (Han et al. 2024, `triangulate.py`, not in
its text), which needs no network. In every round some points are drawn, and places around them from
a normal distribution. A place stays if the patches of the photos around its projections have an
SSIM of at least 0.95 over 5 x 5 pixels.

Its first points are those that a network matched. Here they are of the fused depth of `depth=`, or
the scene's sparse points. Its normal distribution is 10 scene units wide. Here the width is a share
of the point's depth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, NamedTuple

from framework.errors import require
from framework.plugin import Initializer, register

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np

    from framework.types import Camera, DepthMap, Gaussians, TrainingSet, View

SEEDS = ("depth", "points")
FEWEST = 4  # points, to have three neighbours
C1, C2 = 0.01**2, 0.03**2  # of SSIM, of images in [0, 1]
SMALLEST_SCALE = 1e-4  # in scene extents
TOLERANCE = 0.03  # relative difference of depth up to which two views show one surface


@register("init", "patch_growth")
@dataclass(frozen=True)
class PatchGrowth(Initializer):
    """Points that grow where all photos confirm them."""

    title: ClassVar[str] = "Patch growth"
    paper: ClassVar[str] = "binocular"

    seeds: str = "depth"  # first points: of the fused "depth", or the sparse "points"
    per_pixel: float = 0.07  # most points from depth per training pixel
    growth: float = 1.0  # most grown points, relative to the first ones
    rounds: int = 200  # of growth
    drawn: int = 100  # points that a round grows from
    samples: int = 50  # places around each of them
    spread: float = 0.05  # their standard deviation, in mean depths of the point
    similar: float = 0.95  # least SSIM of the patches, for all views that contain the place
    patch: int = 5  # patch size in pixels
    opacity: float = 0.1  # of every Gaussian

    def __post_init__(self) -> None:
        self.check("seeds", self.seeds in SEEDS, f"one of {', '.join(SEEDS)}")
        self.check("per_pixel", 0 < self.per_pixel <= 1, "a number in (0, 1]")
        self.check("growth", 0 <= self.growth <= 1000, "a number in [0, 1000]")
        self.check("rounds", 1 <= self.rounds <= 100_000, "an integer from 1 to 100,000")
        self.check("drawn", 1 <= self.drawn <= 100_000, "an integer from 1 to 100,000")
        self.check("samples", 1 <= self.samples <= 10_000, "an integer from 1 to 10,000")
        self.check("spread", 0 < self.spread <= 10, "a number in (0, 10]")
        self.check("similar", 0 < self.similar <= 1, "a number in (0, 1]")
        self.check("patch", self.patch in (3, 5, 7, 9, 11), "3, 5, 7, 9 or 11")
        self.check("opacity", 0 < self.opacity < 1, "a number in (0, 1)")

    def build(
        self, training: TrainingSet, depth: tuple[DepthMap, ...], sh_degree: int, seed: int
    ) -> Gaussians:
        """Round Gaussians at the points, as large as the way to the three nearest others (3DGS).

        Raises:
            UserError: when there are too few points to begin with.
        """
        from framework.initialize.isotropic import isotropic_gaussians
        from framework.initialize.sparse import neighbour_scales

        xyz, rgb = self._first(training, depth, seed)
        require(
            len(xyz) >= FEWEST,
            f"init=patch_growth: expected at least {FEWEST} points to grow from"
            f" (init.seeds={self.seeds}) in scene {training.scene}, got {len(xyz)}; use"
            f" init.seeds={SEEDS[self.seeds == SEEDS[0]]}, another depth or init=sparse",
        )
        xyz, rgb = self.grown(xyz, rgb, training.views, seed)
        scales = neighbour_scales(xyz, SMALLEST_SCALE * training.extent)
        return isotropic_gaussians(xyz, rgb, scales, self.opacity, sh_degree)

    def _first(
        self, training: TrainingSet, depth: tuple[DepthMap, ...], seed: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Places [P, 3] and colours [P, 3] of the points to begin with."""
        import numpy as np

        from framework.compute.rng import stream
        from framework.initialize.fusion import fuse, mapped

        if self.seeds == "points":
            return training.points.xyz.numpy(), training.points.rgb.numpy()
        pixels = fuse(mapped(training, depth, 0.0), TOLERANCE)
        all_of = sum(view.camera.width * view.camera.height for view in training.views)
        budget = max(FEWEST, round(self.per_pixel * all_of))
        rng = stream(seed, "init/patch_growth/first")
        chosen = np.sort(rng.permutation(len(pixels.xyz))[:budget])
        return pixels.xyz[chosen], pixels.rgb[chosen]

    def grown(
        self, xyz: np.ndarray, rgb: np.ndarray, views: Sequence[View], seed: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """The points and those that grew. A round draws from all there are, and of the places that
        it confirms it takes those first that are around other points."""
        import numpy as np

        from framework.compute.rng import stream
        from framework.depth.transfer import project

        photos = [Photo.of(view, self.patch) for view in views]
        rng = stream(seed, "init/patch_growth/growth")
        quota = math.ceil(self.growth * len(xyz) / self.rounds)
        for _ in range(self.rounds):
            around = xyz[rng.integers(len(xyz), size=self.drawn)]
            away = np.stack([project(photo.camera, around)[:, 2] for photo in photos])
            away = np.maximum(away, 0.0)
            width = self.spread * away.sum(0) / np.maximum((away > 0).sum(0), 1)
            draws = rng.standard_normal((self.samples, self.drawn, 3))
            places = (around + draws * width[:, None]).reshape(-1, 3)
            kept, colours = confirmed(places, photos, self.similar, self.patch)
            xyz = np.concatenate([xyz, places[kept][:quota]])
            rgb = np.concatenate([rgb, colours[kept][:quota]])
        return xyz, rgb


@dataclass(frozen=True)
class Photo:
    """A view prepared for matching.

    Attributes:
        camera: of the view.
        image: [3, H, W] float64.
        mean, variance: [3, H, W], of the patch around each pixel.
        whole: [H, W] bool, whether the patch lies in image and mask.
    """

    camera: Camera
    image: np.ndarray
    mean: np.ndarray
    variance: np.ndarray
    whole: np.ndarray

    @classmethod
    def of(cls, view: View, patch: int) -> Photo:
        import numpy as np
        from scipy.ndimage import minimum_filter, uniform_filter

        image = view.image.numpy().astype(np.float64)
        mean = uniform_filter(image, (0, patch, patch), mode="nearest")
        square = uniform_filter(image * image, (0, patch, patch), mode="nearest")
        valid = np.ones(image.shape[1:], np.uint8)
        if view.mask is not None:
            valid = (view.mask.numpy() > 0.5).astype(np.uint8)
        whole = minimum_filter(valid, patch, mode="constant", cval=0) > 0
        return cls(view.camera, image, mean, np.maximum(square - mean * mean, 0.0), whole)


class At(NamedTuple):
    """Pixels of a photo.

    Attributes:
        photo: the photo.
        row, column: [M].
        there: [M] bool, which of them count.
    """

    photo: Photo
    row: np.ndarray
    column: np.ndarray
    there: np.ndarray

    def only(self, chosen: np.ndarray) -> At:
        """Select by the indices `chosen`."""
        return At(self.photo, self.row[chosen], self.column[chosen], self.there[chosen])


def confirmed(
    places: np.ndarray, photos: Sequence[Photo], similar: float, patch: int
) -> tuple[np.ndarray, np.ndarray]:
    """Check places [M, 3] against all photos that have them in their image, two or more.

    A patch is the one around the pixel that contains the projection. SSIM of two patches is the
    mean over the colours, with population moments and without weights.

    Returns:
        Whether all of these photos confirm it [M] bool, and their mean colour there [M, 3].
    """
    import numpy as np

    seen = [_seen(places, photo) for photo in photos]
    count, colours = np.zeros(len(places)), np.zeros((len(places), 3))
    for at in seen:
        count += at.there
        colours += np.where(at.there[:, None], at.photo.image[:, at.row, at.column].T, 0.0)
    kept: np.ndarray = count >= 2
    for first, one in enumerate(seen):
        for other in seen[first + 1 :]:
            asked = np.flatnonzero(kept & one.there & other.there)
            # no covariance is larger than the deviations allow, so most need no patch
            possible = ssim(one.only(asked), other.only(asked), None) >= similar
            kept[asked[~possible]] = False
            asked = asked[possible]
            a, b = one.only(asked), other.only(asked)
            kept[asked[ssim(a, b, covariance(a, b, patch)) < similar]] = False
    return kept, (colours / np.maximum(count, 1)[:, None]).astype(np.float32)


def _seen(places: np.ndarray, photo: Photo) -> At:
    """Where the places [M, 3] are in a photo, and whether their patches are whole."""
    import numpy as np

    from framework.depth.transfer import inside, project

    uvz = project(photo.camera, places)
    there = inside(photo.camera, uvz)
    column, row = (np.where(there, uvz[:, i], 0.0).astype(np.int64) for i in (0, 1))
    return At(photo, row, column, there & photo.whole[row, column])


def covariance(a: At, b: At, patch: int) -> np.ndarray:
    """[3, M] of the patches around the pixels of two photos."""
    import numpy as np

    total, reach = np.zeros((3, len(a.row))), patch // 2
    for i in range(-reach, reach + 1):
        for j in range(-reach, reach + 1):
            one = a.photo.image[:, a.row + i, a.column + j]
            total += one * b.photo.image[:, b.row + i, b.column + j]
    means = [at.photo.mean[:, at.row, at.column] for at in (a, b)]
    return total / patch**2 - means[0] * means[1]


def ssim(a: At, b: At, shared: np.ndarray | None) -> np.ndarray:
    """[M] SSIM (Wang et al. 2004, eq. 13) with the covariance `shared` [3, M], None: the largest
    there can be, the product of the deviations."""
    import numpy as np

    mean_a, mean_b = (at.photo.mean[:, at.row, at.column] for at in (a, b))
    var_a, var_b = (at.photo.variance[:, at.row, at.column] for at in (a, b))
    if shared is None:
        shared = np.sqrt(var_a * var_b) + 1e-9
    light = (2 * mean_a * mean_b + C1) / (mean_a * mean_a + mean_b * mean_b + C1)
    red, green, blue = light * (2 * shared + C2) / (var_a + var_b + C2)
    mean: np.ndarray = (red + green + blue) / 3
    return mean
