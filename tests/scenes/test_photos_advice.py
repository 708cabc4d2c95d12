"""The report on a search for poses, and the parts of the search."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from framework.scenes.photos.advice import advice, failure
from framework.scenes.photos.options import pairs
from framework.scenes.photos.result import Result
from framework.scenes.photos.search import upright
from tests.scenes.unplaced import FOUND, NAMES


def placed(*missing: int) -> dict[str, int]:
    return {name: 200 for k, name in enumerate(NAMES) if k not in missing}


def test_advice_names_photos_and_neighbours() -> None:
    (line,) = advice(replace(FOUND, placed=placed(5)))
    assert line.startswith(
        "1 of 12 photos could not be placed: p05.jpg (matches: p04.jpg 90, p06.jpg 90); take more"
    )
    features = {**FOUND.features, "p05.jpg": 3}
    (line,) = advice(replace(FOUND, placed=placed(5), features=features))
    assert "p05.jpg (too little texture)" in line
    (line,) = advice(replace(FOUND, placed=placed(*range(6, 12)), links=[]))
    assert "p10.jpg (matches: none) and 1 more" in line


def test_failures_say_why() -> None:
    def told(actual: Result) -> str:
        text = failure(Path("holiday/p00.jpg"), actual)
        assert text.startswith("holiday: expected photos") and "\n" not in text
        return text

    nothing = replace(FOUND, placed={})
    assert "12 of 12 photos without enough" in told(
        replace(nothing, features=dict.fromkeys(NAMES, 9))
    )
    assert "at most 0 matches between two" in told(replace(nothing, links=[]))
    still = [replace(link, shift=0.001) for link in FOUND.links]
    assert "photos from one place (matches move by 0.1 %" in told(replace(nothing, links=still))
    assert "or a camera that only turned (30 pairs" in told(nothing)
    video = failure(Path("clip.mp4"), replace(nothing, links=[], video=True))
    assert video.startswith("clip.mp4: expected")


def test_which_photos_are_compared() -> None:
    assert len(pairs(60)) == 60 * 59 // 2
    chosen = pairs(300)
    assert len(set(chosen)) == len(chosen) < 5000
    assert {(0, 10), (0, 290), (5, 15), (7, 39)} <= set(chosen) and (5, 290) not in chosen


def test_upright_of_odd_cameras() -> None:
    """Cameras that look straight down, or are held every way, still give a rotation."""
    down = np.zeros((2, 3, 4))
    down[:, 0, 0], down[:, 1, 2], down[:, 2, 1] = 1, -1, 1  # ahead is the world's +y
    flipped = np.eye(4)[None, :3].repeat(2, axis=0)
    flipped[1, :2, :2] *= -1
    for views in (down, flipped):
        turn, _ = upright(views)
        assert np.allclose(turn @ turn.T, np.eye(3)) and np.linalg.det(turn) == pytest.approx(1)
