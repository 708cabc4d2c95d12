"""Checks that third-party plugins do not change the tensors that runs of a process share.

A scene and its depth are read once for all runs. A plugin that writes into a photo in place would
silently change the other runs, the baseline too. The project's own plugins have tests
(`tests/contract`); for others a checksum is compared before and after a run.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from torch import Tensor

from framework import registry
from framework.compute.tensors import checksum
from framework.errors import UserError
from framework.run.plugin_code import chosen_plugins
from framework.types import DepthMap, Scene


class Shared:
    """The shared tensors of a run with `foreign` plugins; does nothing without any."""

    def __init__(self, foreign: list[str]) -> None:
        self._foreign = foreign
        self._known: list[tuple[str, Tensor, int]] = []

    def watch(self, parts: Iterable[tuple[str, Tensor]]) -> None:
        """Store the checksums of (description, tensor) pairs."""
        if self._foreign:
            self._known += [(what, tensor, checksum(tensor)) for what, tensor in parts]

    def changed(self) -> list[str]:
        """The descriptions of changed tensors."""
        return [what for what, tensor, sum_ in self._known if checksum(tensor) != sum_]

    def check(self) -> None:
        """Raises UserError where something changed."""
        changed = self.changed()
        if changed:
            raise UserError(
                f"{', '.join(self._foreign)}: expected {changed[0]} unchanged, got other"
                " values than before the run; a plugin wrote into its input: let it clone what it"
                " changes"
            )


def foreign(config: Mapping[str, Any]) -> list[str]:
    """`group=NAME` of the chosen plugins that are not this project's."""
    chosen = chosen_plugins(config).items()
    return [name for name, cls in chosen if cls.__module__.partition(".")[0] not in registry.OURS]


def scene_parts(scene: Scene) -> Iterator[tuple[str, Tensor]]:
    """The tensors of a scene's views."""
    for view in (*scene.training.views, *scene.test):
        for part in ("image", "mask", "depth"):
            tensor = getattr(view, part)
            if tensor is not None:
                yield f"the {part} of view {view.name}", tensor


def depth_parts(scene: Scene, depth: tuple[DepthMap, ...]) -> Iterator[tuple[str, Tensor]]:
    """The tensors of the depth maps of a scene's training views."""
    for view, one in zip(scene.training.views, depth, strict=True):
        yield f"the depth map of view {view.name}", one.depth
        yield f"the depth's confidence of view {view.name}", one.confidence
