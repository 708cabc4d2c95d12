"""Scenes: loaders (name -> frozen dataclass of options with `load() -> Scene`) and split protocols.

Importing this package imports none of the heavy libraries; `load` does.
"""

from framework.scenes.blender import Blender
from framework.scenes.colmap import Colmap, Mip360
from framework.scenes.dtu import Dtu
from framework.scenes.embedded.generate import Embedded
from framework.scenes.llff import Llff
from framework.scenes.photos import Photos
from framework.scenes.splits import ALL, DRAWN, HELD_OUT, UNTESTED, published_split, untested
from framework.scenes.transforms import Transforms

__all__ = [
    "ALL",
    "DRAWN",
    "HELD_OUT",
    "LOADERS",
    "UNTESTED",
    "Embedded",
    "cameras",
    "conventions",
    "decoding",
    "images",
    "lens",
    "photos",
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
