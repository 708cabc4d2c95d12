"""A capacity plugin's edits, applied to the parameters and to the optimizer's memory together."""

from __future__ import annotations

import math

from framework.errors import require
from framework.plugin import Edits
from framework.train.guard import check_appended
from framework.train.optim import Adam
from framework.types import Gaussians, edited


def apply_edits(params: Gaussians, optimizer: Adam, edits: Edits, where: str) -> Gaussians:
    """The edited set; `optimizer` follows it. params: detached. where: for messages.

    Raises UserError when nothing is left, Diverged when what was appended is not finite.
    """
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
