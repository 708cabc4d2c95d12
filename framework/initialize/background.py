"""The colour behind the Gaussians.

A constant colour near the scene's mean leaves the Gaussians the least to explain where no training
view supports them, hence `mean` is the default. Transparent photos are composited over paper, whose
grey is then the mean.
"""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

from framework.errors import require

if TYPE_CHECKING:
    from torch import Tensor

    from framework.types import TrainingSet

log = logging.getLogger(__name__)


def background_color(kind: str, training: TrainingSet) -> Tensor:
    """The background colour [3] float32 of one of `BACKGROUNDS`.

    `mean` is the mean of the valid training pixels, or the colour behind transparent photos.
    `black` and `white` log a warning if that colour differs. With `random`, training steps use
    `random_background` and the evaluation uses the mean, which differs least on average.

    Raises:
        UserError: if the masks leave no pixel to train on.
    """
    import torch

    mean, paper = _mean_color(training), training.paper
    if kind in ("mean", "random"):
        return mean if paper is None else torch.full((3,), paper)
    plain = 1.0 if kind == "white" else 0.0
    if paper not in (None, plain):
        log.warning(
            f"transparent photos were laid on {'white' if paper else 'black'}, renders on {kind}:"
            f" what is clear must be painted; trainer.background=mean takes the photos' paper"
        )
    return torch.full((3,), plain)


def random_background(seed: int, step: int) -> Tensor:
    """[3] float32, uniform in [0, 1): the background of training step `step`."""
    import numpy as np
    import torch

    from framework.compute.rng import stream

    return torch.from_numpy(stream(seed, "background", step).random(3).astype(np.float32))


def _mean_color(training: TrainingSet) -> Tensor:
    """[3] float32, the mean over all pixels of all views, weighted by the masks.

    Summed in numpy: torch splits a large sum among its threads, which changes the last bits.
    """
    import numpy as np
    import torch

    total, count = np.zeros(3), 0.0
    for view in training.views:
        image = view.image.numpy().astype(np.float64)
        mask = np.ones(image.shape[1:]) if view.mask is None else view.mask.numpy()
        total += (image * mask).sum((1, 2), dtype=np.float64)
        count += float(mask.sum(dtype=np.float64))
    require(
        count > 0,
        f"scene {training.scene}: expected valid pixels in the training views, got masks that are"
        " 0 everywhere; check the masks",
    )
    return torch.from_numpy((total / count).astype(np.float32))
