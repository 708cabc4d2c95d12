"""A capacity plugin's edits, applied to the parameters and to the optimizer's memory together."""

from __future__ import annotations

import math
from dataclasses import replace

import torch

from framework.errors import require
from framework.plugin import Edits
from framework.train.guard import check_appended
from framework.train.torch_adam import Optimizer
from framework.types import Gaussians, edited


def apply_edits(params: Gaussians, optimizer: Optimizer, edits: Edits, where: str) -> Gaussians:
    """The edited set; `optimizer` follows it. params: detached. where: for messages.

    Raises UserError when nothing is left, Diverged when what was appended is not finite.
    """
    edits = _placed(edits, params.means.device)
    if edits.sh0 is not None:
        params = params.replace(sh0=edits.sh0)
    if edits.changes_the_rows:
        params = edited(params, edits.keep, edits.bands, edits.append)
        optimizer.edit(edits.keep, edits.bands, edits.append)
    if edits.opacity_ceiling is not None:
        ceiling = math.log(edits.opacity_ceiling / (1 - edits.opacity_ceiling))
        params = params.replace(opacity_logits=params.opacity_logits.clamp(max=ceiling))
        optimizer.zero("opacity_logits")
    require(
        len(params) > 0,
        f"{where}: the capacity plugin removed every Gaussian; soften its pruning (of adc:"
        " capacity.min_opacity), choose capacity=fixed, or start from more Gaussians",
    )
    if edits.append is not None:
        check_appended(edits.append, where)
    return params


def _placed(edits: Edits, device: torch.device) -> Edits:
    """The edits where the parameters are; plugins work on the CPU."""
    if device.type == "cpu":
        return edits
    parts = {name: getattr(edits, name) for name in ("keep", "append", "bands", "sh0")}
    return replace(edits, **{k: part.to(device) for k, part in parts.items() if part is not None})
