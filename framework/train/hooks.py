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

from framework.compute.tensors import checksum
from framework.errors import UserError, plugin_call
from framework.plugin import Edits, Plugin, StepContext, SubStep
from framework.registry import OURS
from framework.shapes import check_finite, check_gaussians, check_tensor, check_view
from framework.types import Gaussians, Render, View

MOST_SUBSTEPS = 1000  # in one step of the training


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
    with at_work("reg", plugin, "substeps", ctx.step, ctx.gaussians, ctx.other):
        asked = iter(plugin.substeps(ctx, state, view))
    for _ in range(MOST_SUBSTEPS):
        with at_work("reg", plugin, "substeps", ctx.step, ctx.gaussians, ctx.other):
            one = next(asked, None)
        if one is None:
            return
        yield sub_step(plugin, one)
    raise UserError(
        f"{_hook('reg', plugin, 'substeps')}: gave more than {MOST_SUBSTEPS} losses in step"
        f" {ctx.step}; end the iterator"
    )


def sub_step(plugin: Plugin, result: object) -> SubStep:
    """A step that `Regularizer.substeps` asks for: (loss, names). Raises UserError."""
    where = _hook("reg", plugin, "substeps")
    loss, names = _pair(where, result, "(loss, names of parameters)")
    known = [part.name for part in fields(Gaussians)]
    if not isinstance(names, list | tuple) or not names or any(n not in known for n in names):
        raise UserError(f"{where}: expected some of {', '.join(known)}, got {names!r:.80}")
    if not isinstance(loss, Tensor) or loss.numel() != 1 or not loss.requires_grad:
        raise UserError(f"{where}: expected a scalar loss of ctx.gaussians, got {loss!r:.80}")
    return loss, names


def gradient(
    plugin: Plugin, given: Mapping[str, Tensor], found: Mapping[str, Tensor]
) -> Mapping[str, Tensor]:
    """What `Regularizer.gradient` gives in the place of `found`. Raises UserError."""
    where = _hook("reg", plugin, "gradient")
    if not isinstance(given, Mapping) or set(given) != set(found):
        got = list(given) if isinstance(given, Mapping) else type(given).__name__
        raise UserError(f"{where}: expected {', '.join(found)}, got {got!s:.80}")
    with _placed(where):
        for name, tensor in found.items():
            check_tensor(f"`{name}`", given[name], *tensor.shape)
    return given


def evaluated(plugin: Plugin, gaussians: Any, terms: int) -> Gaussians:
    """Check what `Regularizer.evaluated` returns, with `terms` SH coefficients beyond the first.

    Raises UserError unless it can be written, read and trained on.
    """
    with _placed(_hook("reg", plugin, "evaluated")):
        check_gaussians("the Gaussians", gaussians, None, terms)
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
def at_work(
    group: str, plugin: Plugin, hook: str, step: int, *given: Gaussians | Render | None
) -> Iterator[None]:
    """Call a hook in here: whatever goes wrong is a UserError that names the plugin and the hook.

    Args:
        given: what the hook may read and not write into.
    """
    where = f"{_hook(group, plugin, hook)}, step {step}"
    watched = [pair for one in given for pair in _tensors(one)]
    before = _marks(plugin, watched)
    with plugin_call(where):
        yield
    for (name, _), old, new in zip(watched, before, _marks(plugin, watched), strict=True):
        if old != new:
            raise UserError(f"{where}: expected {name} unchanged, got it written into; clone it")
    if any(tensor.is_leaf and tensor.grad is not None for _, tensor in watched):
        raise UserError(f"{where}: called backward(); return the loss, the trainer differentiates")


def _tensors(given: Gaussians | Render | None) -> Iterator[tuple[str, Tensor]]:
    if isinstance(given, Gaussians):
        yield from ((f"ctx.gaussians.{name}", tensor) for name, tensor in given.items())
    elif given is not None:
        yield from ((f"render.{part}", getattr(given, part)) for part in ("rgb", "alpha", "depth"))


def _marks(plugin: Plugin, tensors: list[tuple[str, Tensor]]) -> list[tuple[int, int]]:
    """Return what changes when somebody writes into a tensor.

    torch counts its own writes. NumPy's go unseen, so plugins from outside, which no test of this
    project covers, cost a checksum; see `framework.run.untouched`.
    """
    ours = type(plugin).__module__.partition(".")[0] in OURS
    return [(tensor._version, 0 if ours else checksum(tensor)) for _, tensor in tensors]


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
    """Turn what is wrong with a value into a UserError that begins with the hook."""
    with plugin_call(f"{where}: what it returns"):
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
    ceiling = change.opacity_ceiling
    if ceiling is not None and not (type(ceiling) in (int, float) and 0 < ceiling < 1):
        raise ValueError(f"expected an `opacity_ceiling` between 0 and 1, got {ceiling!r:.40}")
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
