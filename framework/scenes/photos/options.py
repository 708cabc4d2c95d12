"""The steps of the search for poses, and pycolmap's options in each.

The first step uses COLMAP's usual features. If photos are left over, later steps use fainter
features and a second, guided matching along the geometry of the first. The last step also uses
descriptors that do not depend on the view's slant (affine shape, domain-size pooling), which is
slow. With `scene.matching=learned` a step with features and matches of networks comes first. Each
step tries COLMAP's usual thresholds, and lower ones if photos are left over. A few photos with few
features cannot reach the hundreds of matches that the usual thresholds require.
"""

from dataclasses import dataclass
from typing import Any

SEED = 0
MOST_EXHAUSTIVE = 60  # photos; 1,770 pairs
NEXT, MILESTONE = 10, 10


@dataclass(frozen=True)
class Step:
    """fewest: matches of a pair that count. peak_threshold: of SIFT's contrast."""

    name: str
    fewest: int
    peak_threshold: float = 0.002
    guided: bool = False
    affine: bool = False
    learned: bool = False


STEPS = (
    Step("usual features", 15, peak_threshold=0.02 / 3),
    Step("fainter features", 10, guided=True),
    Step("fainter features at any slant", 10, guided=True, affine=True),
)
LEARNED_STEP = Step("features of a network", 10, learned=True)
SIFT, LEARNED = "sift", "learned"


def steps(matching: str) -> tuple[Step, ...]:
    """The steps for `scene.matching`."""
    return (LEARNED_STEP, *STEPS) if matching == LEARNED else STEPS


def pairs(n: int) -> list[tuple[int, int]]:
    """The pairs to match among n photos sorted by name.

    All pairs up to 60 photos; above that the time would grow with the square. Cameras number their
    photos in the order of the walk. So each is matched with the next 10 and with those 16, 32, 64
    ... later, and every tenth with every other tenth, which closes loops.
    """

    def matched(i: int, j: int) -> bool:
        gap = j - i
        milestones = i % MILESTONE == 0 and j % MILESTONE == 0
        return gap <= NEXT or milestones or gap.bit_count() == 1

    every = [(i, j) for j in range(n) for i in range(j)]
    return every if n <= MOST_EXHAUSTIVE else [pair for pair in every if matched(*pair)]


def extraction(step: Step, threads: int) -> Any:
    """FeatureExtractionOptions."""
    import pycolmap

    options = pycolmap.FeatureExtractionOptions()
    options.num_threads, options.use_gpu = threads, False
    options.sift.max_num_features = 4096
    options.sift.peak_threshold = step.peak_threshold
    options.sift.estimate_affine_shape = options.sift.domain_size_pooling = step.affine
    return options


def matching(step: Step, threads: int) -> Any:
    """FeatureMatchingOptions."""
    import pycolmap

    options = pycolmap.FeatureMatchingOptions()
    options.num_threads, options.use_gpu = threads, False
    options.guided_matching = step.guided
    return options


def verification(step: Step) -> Any:
    """TwoViewGeometryOptions."""
    import pycolmap

    options = pycolmap.TwoViewGeometryOptions()
    options.min_num_inliers = step.fewest
    options.ransac.random_seed = SEED
    return options


def mapping(step: Step, low: bool, held: bool) -> Any:
    """IncrementalPipelineOptions.

    On one thread: bundle adjustment does not repeat bit for bit on several.

    Args:
        step: of the search.
        low: use lower thresholds than COLMAP.
        held: keep the focal length.
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
