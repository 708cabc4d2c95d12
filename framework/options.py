"""The trainer's options: light to import, so that `--help` and `--cfg` stay instant."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

from framework.errors import check_option

MOST_MEMBERS, MOST_STEPS = 16, 1_000_000
ENOUGH_STEPS, ENOUGH_VISITS = 300, 40  # of one training, and of every view by it
SHARED_BY = 8  # members at most, when their number is left to the views
BACKGROUNDS = ("mean", "black", "white", "random")
PSEUDO_STEPS, PSEUDO_MEANS = ("joined", "own"), ("frame", "covered")


@dataclass(frozen=True)
class TrainerOptions:
    """Options of the shared trainer; every method of a study gets the same.

    Trainings of a few hundred steps need larger rates than the 30,000 steps of 3DGS (Kerbl et al.
    2023, `arguments/__init__.py`; `preset=paper` has its rates). Rates of shapes are 30 times as
    large, of colours 5 times, of opacities 2.5 times, see docs/decisions.md.
    """

    steps: int = 300  # of training, each on one real view; of all members together if members=0
    seconds: float = 0.0  # of training, by the wall clock here: chooses steps; 0 = steps are given
    visits: int = 0  # of every training view at least: many photos get more steps; 0 = as steps say
    sh_degree: int = 0  # stored degree; the active one grows by one every `sh_every` steps
    sh_every: int = 0  # 0 = evenly over the first half of the training (3DGS: 1000 of 30k steps)
    exposure: bool = True  # photos that were exposed differently are made equal first
    ssim_weight: float = 0.4  # loss = (1 - w) L1 + w (1 - SSIM); 0.4 is sharper at the same PSNR
    depth_smoothness: float = 0.01  # weight of depth's steps where the photo has none; 0 = off
    binocular: float = 1.0  # weight of the second camera beside a photo; 0 = off
    binocular_from: float = 0.667  # share of the steps from which it is, and after `enough_steps`
    lr_scale: float = 5.0  # multiplies all learning rates
    lr_means: float = 9.6e-4  # in units of the scene extent
    lr_means_final: float = 0.01  # share of lr_means that is left at the end
    lr_sh0: float = 2.5e-3  # of the colours
    lr_shN_ratio: float = 0.05  # of the higher SH bands, as a share of lr_sh0
    lr_opacities: float = 0.025  # of the logits of the opacities
    lr_scales: float = 0.03  # of the logarithms of the scales
    lr_quats: float = 6e-3  # of the rotations
    lr_final: float = 0.1  # share of the other rates that is left at the end
    opacity_decay: float = 0.99  # opacities are multiplied by it after every step; 1 = off
    opacity_spare: float = 0.0  # what photos hold on to fades less, StereoGS: 0.5; 0 = all alike
    pace_steps: int = 300  # a longer training takes smaller steps, see `schedule.paced`; 0 = not
    pace_views: int = 3  # more views: smaller steps that fade less; 0 = whatever their number
    coarse_factor: int = 2  # images are box-downsampled by it at the beginning
    coarse_until: float = 0.25  # share of the steps that take images smaller by coarse_factor
    coarse_octaves: bool = False  # coarse_factor halves step by step until then (FreeNeRF)
    pseudo_factor: int = 2  # pseudo views are always box-downsampled by it; 1 = as large as photos
    pseudo_steps: str = "joined"  # a pseudo view joins a real one's step, or has its own before it
    pseudo_mean: str = "frame"  # its loss is the mean over the frame, or over the covered pixels
    background: str = "mean"  # colour: mean of the training photos, black, white, random
    near_plane: float = 0.05  # Gaussians nearer are not drawn; in units of the near bound
    evaluations: int = 6  # of the test views, evenly spaced, the last after the last step
    members: int = 0  # trainings from draws of their own, joined in the end; 0 = as many as pay
    kept: int = 1  # members whose Gaussians are kept and taught by all; 0 = keep all, untaught
    tuning: float = 0.05  # share of the steps in which joined members are tuned on the photos

    def __post_init__(self) -> None:
        check = functools.partial(check_option, self, "trainer")
        check("steps", 1 <= self.steps <= MOST_STEPS, f"an integer from 1 to {MOST_STEPS:,}")
        check("seconds", 0 <= self.seconds <= 1e6, "a number in [0, 1,000,000]")
        check("visits", 0 <= self.visits <= 10_000, "an integer from 0 to 10,000")
        check("sh_degree", 0 <= self.sh_degree <= 3, "0, 1, 2 or 3")
        check("sh_every", self.sh_every >= 0, "an integer >= 0")
        check("ssim_weight", 0 <= self.ssim_weight <= 1, "a number in [0, 1]")
        check("depth_smoothness", 0 <= self.depth_smoothness <= 1e3, "a number in [0, 1000]")
        check("binocular", 0 <= self.binocular <= 1e3, "a number in [0, 1000]")
        check("binocular_from", 0 <= self.binocular_from <= 1, "a share in [0, 1]")
        for rate in ("lr_scale", "lr_means", "lr_sh0", "lr_opacities", "lr_scales", "lr_quats"):
            check(rate, 0 <= getattr(self, rate) < 1e3, "a number in [0, 1000)")
        for share in ("lr_means_final", "lr_final", "lr_shN_ratio", "opacity_decay"):
            check(share, 0 < getattr(self, share) <= 1, "a number in (0, 1]")
        check("opacity_spare", 0 <= self.opacity_spare <= 1e3, "a number in [0, 1000]")
        check("pace_steps", self.pace_steps >= 0, "an integer >= 0")
        check("pace_views", self.pace_views >= 0, "an integer >= 0")
        check("coarse_factor", self.coarse_factor in (1, 2, 4, 8), "1, 2, 4 or 8")
        check("pseudo_factor", self.pseudo_factor in (1, 2, 4, 8), "1, 2, 4 or 8")
        check(
            "pseudo_steps", self.pseudo_steps in PSEUDO_STEPS, f"one of {', '.join(PSEUDO_STEPS)}"
        )
        check("pseudo_mean", self.pseudo_mean in PSEUDO_MEANS, f"one of {', '.join(PSEUDO_MEANS)}")
        check("coarse_until", 0 <= self.coarse_until <= 1, "a share in [0, 1]")
        check("background", self.background in BACKGROUNDS, f"one of {', '.join(BACKGROUNDS)}")
        check("near_plane", 0 < self.near_plane <= 1, "a number in (0, 1]")
        check("evaluations", self.evaluations >= 1, "an integer >= 1")
        check("members", 0 <= self.members <= MOST_MEMBERS, f"0 to {MOST_MEMBERS}; 0 chooses")
        check("kept", 0 <= self.kept <= MOST_MEMBERS, f"0 to {MOST_MEMBERS}; 0 keeps all")
        check("tuning", 0 <= self.tuning <= 1, "a share in [0, 1]")


def enough_steps(n_views: int) -> int:
    """The steps of one training that `n_views` pay for, `ENOUGH_VISITS` of every view; beyond them
    it learns few photos by heart."""
    return max(ENOUGH_STEPS, ENOUGH_VISITS * n_views)


def members_of(members: int, steps: int, n_views: int) -> int:
    """Return the number of trainings: `members`, or if that is 0 as many as `steps` in all allow.

    One training takes `enough_steps`. Beyond them several trainings from different draws, whose
    errors cancel, gain more in the same time. A budget of u times enough is shared by sqrt(2 u)
    trainings. So with four times the steps there are twice as many, each twice as long, which is
    sharper than more short ones at the same PSNR (docs/decisions.md).
    """
    return members or min(SHARED_BY, max(1, math.isqrt(2 * steps // enough_steps(n_views))))
