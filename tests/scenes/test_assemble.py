"""What a loader hands over is checked where its view can be named."""

import numpy as np
import pytest

from framework.errors import UserError
from framework.scenes.assemble import Shot, Tracks, assemble

IMAGE = np.zeros((4, 5, 3), dtype=np.uint8)


def test_geographic_coordinates_are_refused() -> None:
    """Gaussians are kept in 32 bits, which round places in another zone by pixels."""

    def far_off(away: float) -> None:
        pose, K = np.eye(4), np.diag([600.0, 600.0, 1.0])
        pose[:3, 3] = -away, -3.0, 0.0
        assemble("s", "p", [Shot("a.png", pose, K, IMAGE)], [], Tracks(), 1.0, 2.0)

    far_off(500.0)
    with pytest.raises(UserError, match=r"before it by 36 pixels; subtract \(500000, 3, 0\)"):
        far_off(5e5)


def test_photos_from_one_place_are_told(caplog: pytest.LogCaptureFixture) -> None:
    poses = [np.eye(4), np.eye(4)]
    for step in (0.02, 0.005):
        poses[1][0, 3] = step
        shots = [Shot(f"{i}.png", pose, np.eye(3), IMAGE) for i, pose in enumerate(poses)]
        assemble("s", "p", shots, [], Tracks(), 1.0, 2.0)
        assert ("from one place" in caplog.text) == (step < 0.01)


@pytest.mark.parametrize(
    ("pixels", "step", "named"),
    [
        (0, 1.0, "a.png is 0.png"),
        (1, 0.1, "a.png is 1.png"),
        (9, 0.1 + 1e-7, "a.png is 1.png"),
        (9, 0.1 + 1e-4, ""),
        (9, 1.0, ""),
    ],
)
def test_test_photos_of_the_training_are_named(
    caplog: pytest.LogCaptureFixture, pixels: int, step: float, named: str
) -> None:
    def shot(name: str, x: float, grey: int) -> Shot:
        pose = np.eye(4)
        pose[0, 3] = -x
        return Shot(name, pose, np.eye(3), IMAGE + np.uint8(grey))

    train = [shot(f"{i}.png", 0.1 * i, i) for i in range(3)]
    assemble("s", "p", train, [shot("a.png", step, pixels)], Tracks(), 1.0, 2.0)
    warned = "1 of 1 test photos have the pixels or the pose of a training photo" in caplog.text
    assert warned == (named != "") and named in caplog.text
