"""A plugin that chooses the camera of its pseudo views, as a third-party author would write it."""

from dataclasses import dataclass
from typing import Any

import pytest

from framework.errors import UserError
from framework.plugin import StepContext
from framework.toolbox.elsewhere import unseen_camera
from framework.toolbox.warping import WarpingAugmenter
from framework.types import Camera
from tests.plugins.fakes import context


@dataclass(frozen=True)
class Between(WarpingAugmenter):
    """Pseudo views between two neighbouring training cameras, warped from all views."""

    def sample_camera(self, ctx: StepContext) -> Camera:
        return unseen_camera(ctx, ctx.rng("camera"), ctx.views[0].camera)

    def select(self, ctx: StepContext, selection: Any, camera: Camera) -> tuple[list[int], Any]:
        return list(range(len(ctx.views))), selection


Between.name = "between"


def test_the_pseudo_view_has_the_camera_that_the_plugin_chose() -> None:
    ctx = context()
    (view,), _ = Between(min_coverage=0.0).pseudo_views(ctx, None)
    expected = Between().sample_camera(context())
    assert view.camera.viewmat.equal(expected.viewmat)
    assert tuple(view.image.shape[1:]) == (expected.height, expected.width)


def test_anything_but_a_camera_is_refused() -> None:
    @dataclass(frozen=True)
    class Nowhere(Between):
        def sample_camera(self, ctx: StepContext) -> Any:
            return None

    Nowhere.name = "nowhere"
    with pytest.raises(UserError, match="augment=nowhere: expected sample_camera"):
        Nowhere().pseudo_views(context(), None)
