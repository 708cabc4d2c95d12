"""A capacity plugin's edits, applied to the parameters and to the optimizer's memory together."""

from __future__ import annotations

import math
from dataclasses import replace

import torch
from torch import Tensor

from framework.errors import require
from framework.plugin import Edits
from framework.train.guard import check_appended
from framework.train.optimizer import Optimizer
from framework.types import Gaussians, edited


def apply_edits(params: Gaussians, optimizer: Optimizer, edits: Edits, where: str) -> Gaussians:
    """The edited set; `optimizer` follows it, and keeps its moments of what got new values.
    params: detached. where: for messages.

    Raises UserError when nothing is left, Diverged when what was appended is not finite.
    """
    edits = _placed(edits, params.means.device)
    if edits.sh0 is not None:
        params = params.replace(sh0=edits.sh0)
    params = params.replace(**edits.values)
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
    there = {k: part.to(device) for k, part in parts.items() if part is not None}
    return replace(edits, **there, values={k: v.to(device) for k, v in edits.values.items()})


def rows_after(params: Gaussians, edits: Edits) -> Tensor:
    """[N'] int64, of every Gaussian after `edits` the row that it had before; -1: appended."""
    n, added = len(params), 0 if edits.append is None else len(edits.append)
    rows = torch.arange(n)
    if edits.keep is not None:
        rows = rows[edits.keep]
    if edits.bands is not None:  # those that keep theirs come first, see `Gaussians.with_bands`
        banded = (rows < len(params.shN)) & edits.bands[rows]
        rows = torch.cat([rows[banded], rows[~banded]])
    if edits.append is None:
        return rows
    new = torch.full((added,), -1)
    banded_before = (
        int((rows < len(params.shN)).sum()) if edits.bands is None else int(banded.sum())
    )
    banded_new = len(edits.append.shN)  # see `concatenate`
    parts = [rows[:banded_before], new[:banded_new], rows[banded_before:], new[banded_new:]]
    return torch.cat(parts)
