"""What the hooks of a plugin return, checked before the trainer uses it: a mistake in somebody's
plugin ends in one line that names the plugin and the hook."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields
from typing import Any

import torch
from torch import Tensor

from framework.errors import UserError
from framework.plugin import Edits, Plugin, StepContext, SubStep
from framework.shapes import check_finite, check_tensor, check_view
from framework.types import Gaussians, View


def pseudo_views(plugin: Plugin, result: object) -> tuple[list[View], Any]:
    """(views, state) of `Augmenter.pseudo_views`. Raises UserError."""
    where = _hook("augment", plugin, "pseudo_views")
    views, state = _pair(where, result, "(list of views, state)")
    if not isinstance(views, list | tuple):
        raise UserError(f"{where}: expected a list of views, got {type(views).__name__}")
    with _placed(where):
        for number, view in enumerate(views):
            check_view(f"view {number}", view)
    return list(views), state


def opacity_factors(plugin: Plugin, result: object, n: int) -> tuple[Tensor | None, Any]:
    """(factors or None, state) of `Regularizer.opacity_factors` for n Gaussians. Raises
    UserError."""
    where = _hook("reg", plugin, "opacity_factors")
    factors, state = _pair(where, result, "(factors or None, state)")
    if factors is not None:
        with _placed(where):
            check_tensor("factors", factors, n)
            least, most = factors.aminmax()
            if not (least >= 0 and math.isfinite(most)):
                raise ValueError("factors: expected finite numbers >= 0, got others")
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


def sub_steps(plugin: Any, ctx: StepContext, state: Any, view: View) -> Iterator[SubStep]:
    """What `Regularizer.substeps` asks for; between two of them the trainer takes the step."""
    with at_work("reg", plugin, "substeps", ctx.step, ctx.gaussians):
        asked = iter(plugin.substeps(ctx, state, view))
    while True:
        with at_work("reg", plugin, "substeps", ctx.step, ctx.gaussians):
            one = next(asked, None)
        if one is None:
            return
        yield sub_step(plugin, one)


def sub_step(plugin: Plugin, result: object) -> SubStep:
    """A step that `Regularizer.substeps` asks for: (loss, names). Raises UserError."""
    where = _hook("reg", plugin, "substeps")
    loss, names = _pair(where, result, "(loss, names of parameters)")
    known = [part.name for part in fields(Gaussians)]
    if not isinstance(names, list | tuple) or not names or not set(names) <= set(known):
        raise UserError(f"{where}: expected some of {', '.join(known)}, got {names!r:.80}")
    if not isinstance(loss, Tensor) or loss.numel() != 1 or not loss.requires_grad:
        raise UserError(f"{where}: expected a scalar loss of ctx.gaussians, got {loss!r:.80}")
    return loss, names


def gradient(
    plugin: Plugin, given: Mapping[str, Tensor], found: Mapping[str, Tensor]
) -> Mapping[str, Tensor]:
    """What `Regularizer.gradient` gives in the place of `found`. Raises UserError."""
    where = _hook("reg", plugin, "gradient")
    if set(given) != set(found):
        raise UserError(f"{where}: expected {', '.join(found)}, got {list(given)!s:.80}")
    with _placed(where):
        for name, tensor in found.items():
            check_tensor(f"`{name}`", given[name], *tensor.shape)
    return given


def evaluated(plugin: Plugin, gaussians: Any) -> Gaussians:
    """What `Regularizer.evaluated` gives. Raises UserError."""
    if not isinstance(gaussians, Gaussians):
        where, got = _hook("reg", plugin, "evaluated"), type(gaussians).__name__
        raise UserError(f"{where}: expected Gaussians, got {got}")
    return gaussians


def edits(plugin: Plugin, result: object, of: Gaussians) -> tuple[Edits | None, Any]:
    """(edits or None, state) of `Capacity.update` of Gaussians. Raises UserError."""
    where = _hook("capacity", plugin, "update")
    change, state = _pair(where, result, "(Edits or None, state)")
    if change is not None and not isinstance(change, Edits):
        raise UserError(f"{where}: expected Edits or None, got {type(change).__name__}")
    if change is not None:
        with _placed(where):
            _check_edits(change, of)
    return change, state


@contextmanager
def at_work(group: str, plugin: Plugin, hook: str, step: int, given: Gaussians) -> Iterator[None]:
    """A hook at work: what it raises says where; what it was given it may not write into. Raises
    UserError where it did."""
    where, before = _hook(group, plugin, hook), _versions(given)
    try:
        yield
    except UserError:
        raise
    except Exception as error:
        error.add_note(f"{where}, step {step}")
        raise
    if _versions(given) != before:
        raise UserError(
            f"{where}, step {step}: expected ctx.gaussians unchanged, got them written into; clone"
            " what changes"
        )


def _versions(gaussians: Gaussians) -> list[int]:
    """torch counts how often each tensor was written into."""
    return [tensor._version for _, tensor in gaussians.items()]


def wanted(plugin: Plugin) -> tuple[str, ...]:
    """The parameters whose gradients a capacity asks for. Raises UserError."""
    names = getattr(plugin, "gradients", ())
    names = names if isinstance(names, str | list | tuple) else (names,)
    known = [part.name for part in fields(Gaussians)]
    unknown = [name for name in names if name not in known]
    if isinstance(names, str) or unknown:
        raise UserError(
            f"{_hook('capacity', plugin, 'gradients')}: expected a tuple of some of"
            f" {', '.join(known)}, got {names!r:.80}"
        )
    return tuple(names)


@contextmanager
def _placed(where: str) -> Iterator[None]:
    """What is wrong with a value (ValueError) as a UserError that begins with the hook."""
    try:
        yield
    except ValueError as error:
        raise UserError(f"{where}: {error}") from error


def _check_edits(change: Edits, of: Gaussians) -> None:
    """Raises ValueError for what does not fit."""
    n = len(of)
    if change.append is not None:
        _check_appended(change.append, of)
    for part, shape, dtype in (
        ("keep", (n,), torch.bool),
        ("bands", (n,), torch.bool),
        ("sh0", (n, 1, 3), torch.float32),
    ):
        value = getattr(change, part)
        if value is not None:
            check_tensor(f"`{part}`", value, *shape, dtype=dtype)
    if change.sh0 is not None:
        check_finite("`sh0`", change.sh0)
    for name, value in change.values.items():
        if name not in (part.name for part in fields(Gaussians)):
            raise ValueError(f"expected parameters in `values`, got {name!r:.40}")
        check_tensor(f"`{name}`", value, *getattr(of, name).shape)
        check_finite(f"`values`: `{name}`", value)


def _check_appended(appended: Any, of: Gaussians) -> None:
    """Rows that fit those of `of`; whether they are finite, the training's guard tells."""
    if not isinstance(appended, Gaussians):
        raise ValueError(f"expected Gaussians in `append`, got {type(appended).__name__}")
    for name, tensor in appended.items():
        n = len(appended.shN) if name == "shN" else len(appended.means)
        wanted = (n, *getattr(of, name).shape[1:])
        if tensor.dtype != torch.float32 or tensor.shape != wanted or n > len(appended.means):
            raise ValueError(
                f"expected float32 {list(wanted)} in `append.{name}`, got"
                f" {str(tensor.dtype).removeprefix('torch.')} {list(tensor.shape)}"
            )


def _hook(group: str, plugin: Plugin, hook: str) -> str:
    """How a message begins. A class that was never registered, as in tests, has no name."""
    return f"{group}={getattr(plugin, 'name', type(plugin).__name__)}: {hook}"


def _pair(where: str, result: object, expected: str) -> tuple[Any, Any]:
    if not isinstance(result, tuple) or len(result) != 2:
        raise UserError(f"{where}: expected to return {expected}, got {type(result).__name__}")
    return result
