"""Checked calls of plugin hooks: a mistake in a plugin becomes one line that names the hook."""

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import torch
from torch import Tensor

from framework.compute.tensors import checksum
from framework.errors import UserError, plugin_call
from framework.plugin import Edits, Plugin, StepContext, SubStep
from framework.registry import OURS
from framework.shapes import check_finite, check_gaussians, check_tensor, check_view
from framework.train.context import Fetched
from framework.types import NAMES, Gaussians, Render, View

MOST_SUBSTEPS = 1000  # in one training step


def plugin_name(plugin: Plugin) -> str:
    """`augment=safi`; a class that was never registered, as in tests, shows its own name."""
    return f"{plugin.group}={getattr(plugin, 'name', type(plugin).__name__)}"


@contextmanager
def checked_call(
    plugin: Plugin, hook: str, step: int, *read_only: Gaussians | Render | None
) -> Iterator[None]:
    """Call a hook inside; every failure is a UserError that names the plugin and the hook.

    Args:
        plugin: the plugin whose hook is called.
        hook: name of the hook.
        step: the training step, for messages.
        read_only: values that the hook must not write into.
    """
    where = f"{_where(plugin, hook)}, step {step}"
    tensors = [pair for value in read_only for pair in _tensors(value)]
    before = _versions(plugin, tensors)
    with plugin_call(where):
        yield
    for (name, _), old, new in zip(tensors, before, _versions(plugin, tensors), strict=True):
        if old != new:
            raise UserError(f"{where}: expected {name} unchanged, got it written into; clone it")
    if any(tensor.is_leaf and tensor.grad is not None for _, tensor in tensors):
        raise UserError(f"{where}: called backward(); return the loss, the trainer differentiates")


def pseudo_views(plugin: Plugin, result: object) -> tuple[list[View], Any]:
    """Check the (views, state) of `Augmenter.pseudo_views`. Raises UserError."""
    where = _where(plugin, "pseudo_views")
    views, state = _pair(where, result, "(list of views, state)")
    if not isinstance(views, list | tuple):
        raise UserError(f"{where}: expected a list of views, got {type(views).__name__}")
    with _named(where):
        for number, view in enumerate(views):
            check_view(f"view {number}", view)
    return list(views), state


def opacity_factors(plugin: Plugin, result: object, n: int) -> tuple[Tensor | None, Any]:
    """Check the (factors, state) of `Regularizer.opacity_factors` for n Gaussians."""
    where = _where(plugin, "opacity_factors")
    factors, state = _pair(where, result, "(factors or None, state)")
    if factors is not None:
        with _named(where):
            check_tensor("factors", factors, n)
            least, most = factors.aminmax()
            if not (least >= 0 and math.isfinite(most)):
                raise ValueError("factors: expected finite numbers >= 0, got others")
    return factors, state


def loss_term(plugin: Plugin, term: Any) -> Tensor | None:
    """Check the loss of `Regularizer.loss`. Raises UserError."""
    if term is None:
        return None
    where = _where(plugin, "loss")
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
    """Iterate `Regularizer.substeps`; the trainer takes a step after each."""
    with checked_call(plugin, "substeps", ctx.step, ctx.gaussians, ctx.other):
        losses = iter(plugin.substeps(ctx, state, view))
    for _ in range(MOST_SUBSTEPS):
        with checked_call(plugin, "substeps", ctx.step, ctx.gaussians, ctx.other):
            result = next(losses, None)
        if result is None:
            return
        yield sub_step(plugin, result)
    raise UserError(
        f"{_where(plugin, 'substeps')}: gave more than {MOST_SUBSTEPS} losses in step"
        f" {ctx.step}; end the iterator"
    )


def sub_step(plugin: Plugin, result: object) -> SubStep:
    """Check one (loss, names) of `Regularizer.substeps`. Raises UserError."""
    where = _where(plugin, "substeps")
    loss, names = _pair(where, result, "(loss, names of parameters)")
    if not isinstance(names, list | tuple) or not names or any(n not in NAMES for n in names):
        raise UserError(f"{where}: expected some of {', '.join(NAMES)}, got {names!r:.80}")
    if not isinstance(loss, Tensor) or loss.numel() != 1 or not loss.requires_grad:
        raise UserError(f"{where}: expected a scalar loss of ctx.gaussians, got {loss!r:.80}")
    return loss, names


def gradient(
    plugin: Plugin, result: Mapping[str, Tensor], expected: Mapping[str, Tensor]
) -> Mapping[str, Tensor]:
    """Check the gradient of `Regularizer.gradient`, which replaces `expected`."""
    where = _where(plugin, "gradient")
    if not isinstance(result, Mapping) or set(result) != set(expected):
        got = list(result) if isinstance(result, Mapping) else type(result).__name__
        raise UserError(f"{where}: expected {', '.join(expected)}, got {got!s:.80}")
    with _named(where):
        for name, tensor in expected.items():
            check_tensor(f"`{name}`", result[name], *tensor.shape)
    return result


def evaluated(plugin: Plugin, gaussians: Any, terms: int) -> Gaussians:
    """Check the Gaussians of `Regularizer.evaluated`, with `terms` SH coefficients above the first.

    Raises:
        UserError: unless they can be written, read and trained on.
    """
    with _named(_where(plugin, "evaluated")):
        check_gaussians("the Gaussians", gaussians, None, terms)
    return gaussians


def edits(plugin: Plugin, result: object, gaussians: Gaussians) -> tuple[Edits | None, Any]:
    """Check the (edits, state) of `Capacity.update` of these Gaussians. Raises UserError."""
    where = _where(plugin, "update")
    change, state = _pair(where, result, "(Edits or None, state)")
    if change is not None and not isinstance(change, Edits):
        raise UserError(f"{where}: expected Edits or None, got {type(change).__name__}")
    if change is not None:
        with _named(where):
            _check_edits(change, gaussians)
    return change, state


def requested_gradients(plugin: Plugin) -> tuple[str, ...]:
    """Check the parameter names in a capacity's `gradients`. Raises UserError."""
    names = getattr(plugin, "gradients", ())
    if not isinstance(names, list | tuple) or any(name not in NAMES for name in names):
        raise UserError(
            f"{_where(plugin, 'gradients')}: expected a tuple of some of {', '.join(NAMES)}, got"
            f" {names!r:.80}"
        )
    return tuple(names)


def _tensors(value: Gaussians | Render | None) -> Iterator[tuple[str, Tensor]]:
    if isinstance(value, Fetched):
        value = value._source  # its copies cannot harm the training
    if isinstance(value, Gaussians):
        yield from ((f"ctx.gaussians.{name}", tensor) for name, tensor in value.items())
    elif value is not None:
        yield from ((f"render.{part}", getattr(value, part)) for part in ("rgb", "alpha", "depth"))


def _versions(plugin: Plugin, tensors: list[tuple[str, Tensor]]) -> list[tuple[int, int]]:
    """Return values that change when a tensor is written into.

    torch counts its own writes but not NumPy's. For plugins from outside, which no test of this
    project covers, a checksum is added.
    """
    ours = type(plugin).__module__.partition(".")[0] in OURS
    return [(tensor._version, 0 if ours else checksum(tensor)) for _, tensor in tensors]


@contextmanager
def _named(where: str) -> Iterator[None]:
    """Turn a ValueError about a returned value into a UserError that begins with the hook."""
    with plugin_call(f"{where}: what it returns"):
        try:
            yield
        except ValueError as error:
            raise UserError(f"{where}: {error}") from error


def _check_edits(change: Edits, gaussians: Gaussians) -> None:
    """Raise ValueError for edits that do not fit the Gaussians."""
    n = len(gaussians)
    if change.append is not None:
        _check_appended(change.append, gaussians)
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
        if name not in NAMES:
            raise ValueError(f"expected parameters in `values`, got {name!r:.40}")
        check_tensor(f"`{name}`", value, *getattr(gaussians, name).shape)
        check_finite(f"`values`: `{name}`", value)


def _check_appended(appended: Any, gaussians: Gaussians) -> None:
    """Raise ValueError unless the rows fit; `guard` checks that they are finite."""
    if not isinstance(appended, Gaussians):
        raise ValueError(f"expected Gaussians in `append`, got {type(appended).__name__}")
    for name, tensor in appended.items():
        n = len(appended.shN) if name == "shN" else len(appended.means)
        expected = (n, *getattr(gaussians, name).shape[1:])
        if tensor.dtype != torch.float32 or tensor.shape != expected or n > len(appended.means):
            raise ValueError(
                f"expected float32 {list(expected)} in `append.{name}`, got"
                f" {str(tensor.dtype).removeprefix('torch.')} {list(tensor.shape)}"
            )


def _where(plugin: Plugin, hook: str) -> str:
    return f"{plugin_name(plugin)}: {hook}"


def _pair(where: str, result: object, expected: str) -> tuple[Any, Any]:
    if not isinstance(result, tuple) or len(result) != 2:
        raise UserError(f"{where}: expected to return {expected}, got {type(result).__name__}")
    return result
