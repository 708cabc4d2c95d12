"""What the hooks of a plugin return, checked before the trainer uses it: a mistake in somebody's
plugin ends in one line that names the plugin and the hook."""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor

from framework.errors import UserError
from framework.plugin import Edits, Plugin
from framework.shapes import check_tensor, check_view
from framework.types import View


def pseudo_views(plugin: Plugin, result: object) -> tuple[list[View], Any]:
    """(views, state) of `Augmenter.pseudo_views`. Raises UserError."""
    where = _hook("augment", plugin, "pseudo_views")
    views, state = _pair(where, result, "(list of views, state)")
    if not isinstance(views, list | tuple):
        raise UserError(f"{where}: expected a list of views, got {type(views).__name__}")
    try:
        for number, view in enumerate(views):
            check_view(f"view {number}", view)
    except ValueError as error:
        raise UserError(f"{where}: {error}") from error
    return list(views), state


def opacity_factors(plugin: Plugin, result: object, n: int) -> tuple[Tensor | None, Any]:
    """(factors or None, state) of `Regularizer.opacity_factors` for n Gaussians. Raises
    UserError."""
    where = _hook("reg", plugin, "opacity_factors")
    factors, state = _pair(where, result, "(factors or None, state)")
    if factors is not None:
        try:
            check_tensor("factors", factors, n)
        except ValueError as error:
            raise UserError(f"{where}: {error}") from error
    return factors, state


def loss_term(plugin: Plugin, term: Any) -> Tensor | None:
    """What `Regularizer.loss` gives. Raises UserError."""
    if term is None:
        return None
    where = _hook("reg", plugin, "loss")
    if not isinstance(term, Tensor) or term.numel() != 1:
        shape = f" {list(term.shape)}" if isinstance(term, Tensor) else ""
        raise UserError(f"{where}: expected a scalar tensor, got {type(term).__name__}{shape}")
    if not term.requires_grad:
        raise UserError(
            f"{where}: expected a loss of the render's rgb, alpha or depth or of ctx.gaussians, got"
            " one without a gradient; return None for no loss"
        )
    value = float(term.detach())
    if not math.isfinite(value):
        raise UserError(f"{where}: expected a finite number, got {value}")
    return term


def edits(plugin: Plugin, result: object, n: int) -> tuple[Edits | None, Any]:
    """(edits or None, state) of `Capacity.update` for `n` Gaussians. Raises UserError."""
    where = _hook("capacity", plugin, "update")
    change, state = _pair(where, result, "(Edits or None, state)")
    if change is not None and not isinstance(change, Edits):
        raise UserError(f"{where}: expected Edits or None, got {type(change).__name__}")
    if change is not None:
        for part, shape, dtype in (
            ("keep", (n,), torch.bool),
            ("bands", (n,), torch.bool),
            ("sh0", (n, 1, 3), torch.float32),
        ):
            value = getattr(change, part)
            if value is None:
                continue
            try:
                check_tensor(f"`{part}`", value, *shape, dtype=dtype)
            except ValueError as error:
                raise UserError(f"{where}: {error}") from error
    return change, state


def _hook(group: str, plugin: Plugin, hook: str) -> str:
    """How a message begins. A class that was never registered, as in tests, has no name."""
    return f"{group}={getattr(plugin, 'name', type(plugin).__name__)}: {hook}"


def _pair(where: str, result: object, expected: str) -> tuple[Any, Any]:
    if not isinstance(result, tuple) or len(result) != 2:
        raise UserError(f"{where}: expected to return {expected}, got {type(result).__name__}")
    return result
