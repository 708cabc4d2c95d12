"""The stages before a training: what a run says about the user's own photos."""

from __future__ import annotations

import dataclasses
import logging

import pytest

from framework.plugin import SceneLoader, register
from framework.run import preparation
from framework.run.plane import textured_plane
from framework.types import Scene
from tests.documents.registered import as_before


def lines(caplog: pytest.LogCaptureFixture, tested: bool, copies: int = 1) -> list[str]:
    """What loading a scene of three photos, or several times as many, logs."""
    with as_before(), caplog.at_level(logging.INFO):

        @register("scene", "own_photos")
        @dataclasses.dataclass(frozen=True)
        class OwnPhotos(SceneLoader):
            n_views: str = "all"

            def load(self) -> Scene:
                training, _, _ = textured_plane(0)
                views = tuple(
                    dataclasses.replace(view, name=f"{k}-{view.name}")
                    for k in range(copies)
                    for view in training.views
                )
                test, train = (views[:1], views[1:]) if tested else ((), views)
                training = dataclasses.replace(training, views=train)
                return Scene("own", "llff" if tested else "none", training, test, "0")

        preparation.forget()
        preparation.load_scene((("name", "own_photos"), ("n_views", "all")))
        preparation.forget()
    return caplog.messages


def test_three_photos_are_told_how_many_train_and_what_they_can_do(
    caplog: pytest.LogCaptureFixture,
) -> None:
    counts, expectation = lines(caplog, tested=True)
    assert "3 photos: 2 for training, 1 for testing (0-plane-0)" in counts
    assert "scene.split=none" in counts
    assert "between the cameras" in expectation and "back of an object" in expectation


def test_without_test_photos_only_the_expectation_is_said(caplog: pytest.LogCaptureFixture) -> None:
    (expectation,) = lines(caplog, tested=False)
    assert "between the cameras" in expectation


def test_many_photos_only_have_their_counts_said(caplog: pytest.LogCaptureFixture) -> None:
    (counts,) = lines(caplog, tested=True, copies=4)
    assert "12 photos: 11 for training, 1 for testing" in counts
