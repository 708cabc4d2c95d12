"""The stages before a training: what a run says about the user's own photos."""

import dataclasses
import logging

import pytest

from framework.plugin import SceneLoader, register
from framework.run import preparation
from framework.run.plane import textured_plane
from framework.types import Scene
from tests.documents.registered import as_before


def test_three_photos_are_told_how_many_train_and_what_they_can_do(
    caplog: pytest.LogCaptureFixture,
) -> None:
    with as_before(), caplog.at_level(logging.INFO):

        @register("scene", "own_photos")
        @dataclasses.dataclass(frozen=True)
        class OwnPhotos(SceneLoader):
            n_views: str = "all"

            def load(self) -> Scene:
                training, _, _ = textured_plane(0)
                few = dataclasses.replace(training, views=training.views[1:])
                return Scene("own", "llff", few, training.views[:1], "0")

        preparation.forget()
        preparation.load_scene((("name", "own_photos"), ("n_views", "all")))
        preparation.forget()
    counts, expectation = caplog.messages
    assert "3 photos: 2 for training, 1 for testing (plane-0)" in counts
    assert "scene.split=none" in counts
    assert "between the cameras" in expectation and "back of an object" in expectation
