"""Weights of IterMVS: `fishersplat fetch itermvs --from FILE` converts a published checkpoint."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import torch
from torch import Tensor

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


def converted(state: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Rename a published state dictionary and fold batch norms into convolutions.

    Args:
        state: `model` of a checkpoint of the reference implementation.

    Returns:
        Weights for `framework.depth.itermvs.network.IterMvs`, float32.
    """
    names = {name for name in state if ".bn." not in name}
    weights = {_renamed(name): state[name].float() for name in names}
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


def read_checkpoint(file: Path) -> dict[str, Tensor]:
    """Read and convert a published checkpoint, without executing anything in it."""
    return converted(torch.load(file, map_location="cpu", weights_only=True)["model"])
