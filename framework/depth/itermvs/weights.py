"""Weights of IterMVS: `fishersplat fetch itermvs --from FILE` converts a published checkpoint.

The checkpoints are in github.com/FangjinhuaWang/IterMVS at 453e9c72 (MIT licence), as
`checkpoints/blendedmvs/model_000015.ckpt` and `checkpoints/dtu/model_000015.ckpt`. The converted
weights are stored in the cache, as safetensors.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from framework.errors import UserError, require
from framework.files.cache import cache_dir
from framework.files.limits import MIB
from framework.files.opened import file_size
from framework.files.whole import file_sha256, write_whole

if TYPE_CHECKING:
    from torch import Tensor

SHA256 = {
    "blendedmvs": "8563268624cf203750212a0e0bfa4825a5af05c0005a225ef02f138258b0fc42",
    "dtu": "44fbe8e536f94b5df03c7a1cc170c8224f69ecf1d51e6195279067fa9d8c0378",
}
LARGEST_BYTES = 16 * MIB
BN_EPSILON = 1e-5  # of PyTorch's BatchNorm2d
RENAMED = (  # part of a published name -> ours
    (r"^module\.", ""),
    (r"^feature_net\.", "features."),
    (r"^iter_mvs\.", ""),
    (r"^evaluation\.pixel_view_weight\.conv\.", "visibility."),
    (r"^update\.gru\.", "gru."),
    (r"^update\.depth_head\.", "depth."),
    (r"^update\.confidence_head\.", "confidence."),
    (r"^update\.hidden_init_head\.", "hidden."),
    (r"\.conv\.weight$", ".weight"),
)


def cached_file(name: str) -> Path:
    """Return the path of converted weights in the cache, whether the file exists or not."""
    return cache_dir() / "itermvs" / f"{name}-{SHA256[name][:12]}.safetensors"


def require_weights(name: str) -> Path:
    """Return the path of the converted weights `name`.

    Raises:
        UserError: They have not been fetched.
    """
    path = cached_file(name)
    require(
        path.is_file(),
        f"depth.weights={name}: no IterMVS weights in {path.parent}; download the checkpoint"
        f" checkpoints/{name}/model_000015.ckpt of github.com/FangjinhuaWang/IterMVS and run"
        " `fishersplat fetch itermvs --from FILE`",
    )
    return path


def fetch(file: Path) -> Path:
    """Convert a published checkpoint and store it in the cache.

    Args:
        file: one of the two checkpoints.

    Returns:
        The path of the converted weights.

    Raises:
        UserError: `file` is not one of the checkpoints.
    """
    require(
        file.is_file(), f"--from: expected an IterMVS checkpoint, got '{file}', which is no file"
    )
    file_size(file, LARGEST_BYTES)
    digest = file_sha256(file)
    names = [name for name, expected in SHA256.items() if expected == digest]
    if not names:
        raise UserError(
            f"{file}: SHA-256 {digest[:12]}... is none of the known IterMVS checkpoints"
            f" ({', '.join(SHA256)}); download model_000015.ckpt again"
        )
    from safetensors.torch import save

    path = cached_file(names[0])
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, save(read_checkpoint(file)))
    return path


def load(name: str) -> dict[str, Tensor]:
    """Read converted weights from the cache; UserError if they have not been fetched."""
    from safetensors.torch import load_file

    return load_file(require_weights(name))


def read_checkpoint(file: Path) -> dict[str, Tensor]:
    """Read and convert a published checkpoint, without executing anything in it."""
    import torch

    return converted(torch.load(file, map_location="cpu", weights_only=True)["model"])


def converted(state: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Rename a published state dictionary and fold batch norms into convolutions.

    Args:
        state: `model` of a checkpoint of the reference implementation.

    Returns:
        Weights for `framework.depth.itermvs.network.IterMvs`, float32.
    """
    weights = {_renamed(name): value.float() for name, value in state.items() if ".bn." not in name}
    for name in state:
        if name.endswith(".bn.weight"):
            prefix = name.removesuffix(".bn.weight")
            mean, variance = (state[f"{prefix}.bn.running_{key}"] for key in ("mean", "var"))
            scale = state[name] / (variance + BN_EPSILON).sqrt()
            ours = _renamed(f"{prefix}.conv.weight").removesuffix(".weight")
            weights[f"{ours}.weight"] = state[f"{prefix}.conv.weight"] * scale.view(-1, 1, 1, 1)
            weights[f"{ours}.bias"] = state[f"{prefix}.bn.bias"] - mean * scale
    return weights


def _renamed(name: str) -> str:
    for pattern, replacement in RENAMED:
        name = re.sub(pattern, replacement, name)
    return re.sub(r"^evaluation\.corr_conv1\.(\d)\.", lambda m: f"costs{int(m[1]) + 1}.", name)
