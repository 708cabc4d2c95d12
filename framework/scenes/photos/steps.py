"""How poses are looked for: which settings, in which order, and which photos are compared.

The first try has COLMAP's usual features. Where it leaves photos over, later ones take fainter
features, look for matches a second time along the geometry that the first ones gave (guided), and
describe features independently of the view's slant (affine shape, domain-size pooling: slow). Each
try places the photos with COLMAP's usual thresholds, and with lower ones if that leaves photos
over: few photos of few features cannot have the hundreds of matches that the usual ones ask for.

Few photos from one side often do not tell the focal length, and it runs off to anything. EXIF may
be wrong too: of photos that were cropped, or edited. So where the found one is implausible, or far
from EXIF's, the photos are placed again with the focal length held at what EXIF says, else at 1.2
times the longer side (42 mm on film), without lens distortion. A plausible one that was found wins
over EXIF's if it fits clearly better: then the photos do tell it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

SEED = 0
MOST_EXHAUSTIVE = 60  # photos; 1,770 pairs
NEXT, MILESTONE = 10, 10
FOCAL = (0.4, 3.0)  # of the longer side: 14 to 108 mm on film
FOCAL_EXIF = 1.1  # as a ratio, found and EXIF's are about the same
WORSE = 1.25  # reprojection error; seen: 1.0 where EXIF is right, 1.4 to 4.6 where it is wrong
DISTORTION = 0.5  # of the coefficient k1


@dataclass(frozen=True)
class Step:
    """peak_threshold: of SIFT's contrast. fewest: matches of a pair that count."""

    name: str
    peak_threshold: float
    guided: bool
    affine: bool
    fewest: int


STEPS = (
    Step("usual features", 0.02 / 3, guided=False, affine=False, fewest=15),
    Step("fainter features", 0.002, guided=True, affine=False, fewest=10),
    Step("fainter features at any slant", 0.002, guided=True, affine=True, fewest=10),
)


def pairs(n: int) -> list[tuple[int, int]]:
    """Which of n photos, sorted by name, are compared.

    All with all up to 60. Above that time would grow with the square; the usual way out, a tree of
    visual words, is a download of its own. But cameras number their photos, and who takes that many
    walks: so each is compared with the next 10, with those 16, 32, 64 ... later, and every tenth
    with every other tenth, which closes the loop where the walk came back.
    """

    def compared(i: int, j: int) -> bool:
        gap = j - i
        milestones = i % MILESTONE == 0 and j % MILESTONE == 0
        return gap <= NEXT or milestones or gap.bit_count() == 1

    every = [(i, j) for j in range(n) for i in range(j)]
    return every if n <= MOST_EXHAUSTIVE else [pair for pair in every if compared(*pair)]


def plausible(focal_px: float, k1: float, side_px: int) -> bool:
    """Whether a camera may be so: focal length and longer side in pixels, distortion."""
    low, high = FOCAL
    return low <= focal_px / side_px <= high and abs(k1) <= DISTORTION


def agree(exif_px: float, found_px: float) -> bool:
    """Whether two focal lengths are about the same."""
    return max(exif_px, found_px) <= FOCAL_EXIF * min(exif_px, found_px)


def decisive(held_px: float, free_px: float) -> bool:
    """Whether the reprojection error with the given focal length says that it is wrong, against the
    one with the found focal length."""
    return held_px > WORSE * free_px


def extraction(step: Step, threads: int) -> Any:
    """pycolmap's options."""
    import pycolmap

    options = pycolmap.FeatureExtractionOptions()
    options.num_threads, options.use_gpu = threads, False
    options.sift.max_num_features = 4096
    options.sift.peak_threshold = step.peak_threshold
    options.sift.estimate_affine_shape = options.sift.domain_size_pooling = step.affine
    return options


def matching(step: Step, threads: int) -> Any:
    """pycolmap's options."""
    import pycolmap

    options = pycolmap.FeatureMatchingOptions()
    options.num_threads, options.use_gpu = threads, False
    options.guided_matching = step.guided
    return options


def verification(step: Step) -> Any:
    """pycolmap's options."""
    import pycolmap

    options = pycolmap.TwoViewGeometryOptions()
    options.min_num_inliers = step.fewest
    options.ransac.random_seed = SEED
    return options


def mapping(step: Step, low: bool, held: bool) -> Any:
    """pycolmap's options; low: with lower thresholds than COLMAP's own; held: the focal length.

    On one thread: features and matches have the same bits on any number, bundle adjustment has not
    (seen on 4 threads once in a few runs).
    """
    import pycolmap

    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads = options.mapper.num_threads = 1
    for part in (options, options.mapper, options.triangulation):
        part.random_seed = SEED
    options.min_model_size, options.max_num_models = 3, 10
    if held:
        options.ba_refine_focal_length = options.ba_refine_extra_params = False
        options.mapper.abs_pose_refine_focal_length = False
        options.mapper.abs_pose_refine_extra_params = False
    if low:
        options.min_num_matches = step.fewest
        options.mapper.init_min_num_inliers = 30
        options.mapper.abs_pose_min_num_inliers = 12
        options.mapper.init_min_tri_angle = 4
    return options
