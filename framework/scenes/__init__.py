"""Scenes: loaders (name -> frozen dataclass of options with `load() -> Scene`) and split protocols.

Importing this package imports none of the heavy libraries; `load` does.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from framework.errors import UserError, nearest_hint
from framework.scenes.blender import Blender
from framework.scenes.colmap import Colmap
from framework.scenes.dtu import Dtu
from framework.scenes.embedded import Embedded
from framework.scenes.llff import Llff
from framework.scenes.mip360 import Mip360
from framework.scenes.photos import Photos
from framework.scenes.splits import ALL, DRAWN, HELD_OUT, UNTESTED, published_split, untested
from framework.scenes.transforms import Transforms

if TYPE_CHECKING:
    from framework.types import Scene

__all__ = [
    "ALL",
    "DRAWN",
    "HELD_OUT",
    "LOADERS",
    "UNTESTED",
    "Blender",
    "Colmap",
    "Dtu",
    "Embedded",
    "Llff",
    "Mip360",
    "Transforms",
    "cameras",
    "images",
    "lens",
    "load_scene",
    "published_split",
    "transforms_file",
    "untested",
]

LOADERS: dict[str, type] = {
    "embedded": Embedded,
    "llff": Llff,
    "dtu": Dtu,
    "mip360": Mip360,
    "blender": Blender,
    "transforms": Transforms,
    "colmap": Colmap,
    "photos": Photos,
}


def load_scene(name: str, options: Mapping[str, Any]) -> Scene:
    """The scene that loader `name` makes of `options`. Raises UserError on a bad one."""
    if name not in LOADERS:
        raise UserError(f"scene={name}: unknown loader; {nearest_hint(name, LOADERS)}")
    known = {option.name: option for option in dataclasses.fields(LOADERS[name])}
    for key in options:
        if key not in known:
            raise UserError(f"scene={name}: unknown option '{key}'; {nearest_hint(key, known)}")
    for key, option in known.items():
        if option.default is dataclasses.MISSING and key not in options:
            raise UserError(f"scene={name}: expected {key}, got nothing; give scene.{key}=...")
    scene: Scene = LOADERS[name](**options).load()
    return scene
