"""Parts of a run, by their names and options."""

from collections.abc import Mapping
from typing import Any

from framework import registry
from framework.plugin import DepthProvider
from framework.registry import ActivePlugin
from framework.run.members import IDLE
from framework.train.resume.training_state import Plugins
from framework.types import Scene


def load_scene(name: str, options: Mapping[str, Any]) -> Scene:
    """What `scene=name` makes of these options. Raises UserError on a bad one."""
    scene: Scene = registry.part("scene", {"name": name, **options}).load()
    return scene


def build_provider(name: str, options: Mapping[str, Any]) -> DepthProvider:
    """`depth=name` with these options. Raises UserError on a bad one."""
    provider: DepthProvider = registry.part("depth", {"name": name, **options})
    return provider


def plugins(**changes: ActivePlugin | Mapping[str, ActivePlugin]) -> Plugins:
    """Plugins that do nothing, but for the groups given: one plugin, or several by their keys."""
    each: dict[str, ActivePlugin] = {}
    for group, idle in Plugins.of(IDLE).each.items():
        chosen = changes.get(group, idle)
        each |= {group: chosen} if isinstance(chosen, ActivePlugin) else chosen
    return Plugins(each)
