"""Checks of what third-party scene loaders, depth providers and initializers return.

The message names the plugin; `framework.plugin` has the contracts. The project's own parts have
tests instead."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from framework.errors import UserError, plugin_call
from framework.shapes import check_kind, check_tensor, check_view
from framework.types import DepthMap, Scene, SparsePoints, TrainingSet

T = TypeVar("T")


def ask(where: str, part: object, method: Callable[[], T], check: Callable[[T], None]) -> T:
    """Call a method of a part of a run, and check what it returns if the part is a plugin.

    Args:
        where: names the plugin and its method in messages.
        part: the scene loader, depth provider or initializer.
        method: the method with its arguments.
        check: raises ValueError for a wrong value.

    Raises:
        UserError: The plugin raised an exception, or the value is wrong.
    """
    if type(part).__module__.partition(".")[0] == "framework":
        return method()
    with plugin_call(where):
        answer = method()
    with plugin_call(f"{where}: what it returns"):
        try:
            check(answer)
        except ValueError as error:
            raise UserError(f"{where}: {error}; fix the plugin") from error
    return answer


def check_scene(answer: Any) -> None:
    """Raise ValueError unless it is a Scene that can be trained on."""
    check_kind("the scene", answer, Scene)
    for text in ("name", "protocol", "fingerprint"):
        check_kind(f"the scene's {text}", getattr(answer, text), str)
        if not getattr(answer, text):
            raise ValueError(f"the scene's {text}: expected a text, got an empty one")
    check_kind("the training set", answer.training, TrainingSet)
    if not answer.training.views:
        raise ValueError("the training set: expected at least one view, got none")
    for part, views in (("training", answer.training.views), ("test", answer.test)):
        check_kind(f"the {part} views", views, tuple)
        for number, view in enumerate(views):
            check_view(f"{part} view {number}", view)
    names = [view.name for view in (*answer.training.views, *answer.test)]
    if len(set(names)) < len(names):
        raise ValueError("the views: expected different names, got one twice")
    check_kind("the points", answer.training.points, SparsePoints)
    if not 0 < answer.training.near < answer.training.far:
        near, far = answer.training.near, answer.training.far
        raise ValueError(f"the bounds: expected 0 < near < far, got {near} and {far}")


def check_depth(answer: Any, training: TrainingSet) -> None:
    """Raise ValueError unless there is a valid map for each training view."""
    check_kind("the maps", answer, tuple)
    if len(answer) != len(training.views):
        views = len(training.views)
        raise ValueError(f"expected a map for each of {views} training views, got {len(answer)}")
    for view, one in zip(training.views, answer, strict=True):
        check_kind(f"the map of {view.name}", one, DepthMap)
        for part in ("depth", "confidence"):
            size = view.camera.height, view.camera.width
            check_tensor(f"the {part} of {view.name}", getattr(one, part), *size)
        if not bool((one.depth.isfinite() & (one.depth >= 0)).all()):
            raise ValueError(f"the depth of {view.name}: expected finite numbers >= 0")
        if not bool(((one.confidence >= 0) & (one.confidence <= 1)).all()):
            raise ValueError(f"the confidence of {view.name}: expected numbers in [0, 1]")
