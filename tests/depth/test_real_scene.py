"""The plane sweep on a photographed pair with measured depth."""

from pathlib import Path

import numpy as np
import pytest

SCENE = Path(__file__).parents[3] / "shared" / "data" / "open" / "middlebury_motorcycle"


@pytest.mark.skipif(not SCENE.is_dir(), reason="no shared/data/open beside the repository")
def test_most_confident_pixels_are_right_on_a_measured_pair() -> None:
    from benchmarks.quality.depth_middlebury import load_pair
    from tests.built import build_provider

    left = build_provider("plane_sweep", {}).estimate(load_pair(SCENE))[0]
    truth = np.load(SCENE / "depth_left.npz")["depth_mm"]
    confident = (left.confidence.numpy() > 0) & (truth > 0)
    error = np.abs(left.depth.numpy()[confident] / truth[confident] - 1)
    assert confident.sum() > 0.85 * (truth > 0).sum()
    assert (error < 0.01).mean() > 0.86
    assert (error < 0.03).mean() > 0.93
