"""Checks that a training can continue from a `TrainerState`: its parts fit each other and the run.

A checkpoint's checksum detects accidents, not intent. These checks bound what a forged checkpoint
could do: every tensor comes from the file, so it is no larger, and has the expected shape.
"""

from collections.abc import Mapping
from typing import Any

from framework.options import TrainerOptions
from framework.plugin import Plugin
from framework.records.run_files import HistoryRow
from framework.shapes import (
    check_count,
    check_gaussians,
    check_kind,
    check_number,
    check_tensor,
    check_view,
)
from framework.train.optimizer import AdamState
from framework.train.resume.training_state import FieldState, PluginState, TrainerState
from framework.types import TrainingSet

FOREIGN = (TypeError, AttributeError, KeyError, IndexError, RuntimeError)  # from a plugin's check


def check_state(
    state: TrainerState,
    training: TrainingSet,
    options: TrainerOptions,
    plugins: Mapping[str, Plugin],
) -> None:
    """Raise ValueError, naming the part, unless `state` is one of a training on `training` with
    these options and plugins (by the keys of their states)."""
    check_count("step", state.step, options.steps)
    check_count("epoch", state.epoch, state.step)
    check_count("resumed", state.resumed)
    _check_dose(state.dose)
    check_kind("pseudo", state.pseudo, tuple)
    for i, view in enumerate(state.pseudo):
        check_view(f"pseudo {i}", view)
    check_count("left", state.left, len(training.views))
    _check_history(state)
    terms = (options.sh_degree + 1) ** 2 - 1
    wants = any(plugin.second_field for plugin in plugins.values())
    check_kind("second field", state.second, FieldState if wants else type(None))
    updates = sum(state.dose.get(name, (0, 0.0))[0] for name in ("steps", "substeps"))
    changes = state.step * sum(key.partition(".")[0] == "capacity" for key in plugins)
    for field in filter(None, (state.field, state.second)):
        check_kind("field", field, FieldState)
        check_count("version", field.version, changes)
        check_gaussians("gaussians", field.gaussians, None, terms)
        _check_adam(field, max(state.step, updates), terms)
        _check_plugins(field, training, plugins)


def _check_adam(state: FieldState, updates: int, terms: int) -> None:
    adam: Any = state.adam
    check_kind("adam", adam, AdamState)
    n = len(state.gaussians)
    check_gaussians("adam.first", adam.first, n, terms)
    check_gaussians("adam.second", adam.second, n, terms)
    for moments in (adam.first, adam.second):
        check_tensor("adam.shN", moments.shN, *state.gaussians.shN.shape)
    for name, tensor in adam.second.items():
        if tensor.numel() and float(tensor.detach().min()) < 0:
            raise ValueError(f"adam.second.{name}: expected squares, got a negative number")
    check_kind("adam.steps", adam.steps, tuple)
    if len(adam.steps) != len(adam.first.items()):
        raise ValueError(f"adam.steps: expected one per tensor, got {len(adam.steps)}")
    for steps in adam.steps:
        check_count("adam.steps", steps, updates)


def _check_dose(dose: Any) -> None:
    check_kind("dose", dose, dict)
    for name, tally in dose.items():
        check_kind("dose", name, str)
        check_kind(f"dose {name:.40}", tally, tuple)
        if len(tally) != 2:
            raise ValueError(f"dose {name:.40}: expected a count and a sum, got {len(tally)}")
        check_count(f"dose {name:.40}", tally[0])
        check_kind(f"dose {name:.40}", tally[1], float)


def _check_history(state: TrainerState) -> None:
    check_kind("history", state.history, tuple)
    for row in state.history:
        check_kind("history", row, HistoryRow)
        for name in ("step", "gaussians", "sh_degree"):
            check_count(f"history.{name}", getattr(row, name))
        for name in ("seconds", "loss"):
            check_number(f"history.{name}", getattr(row, name))
        _check_psnr("history.test_psnr", row.test_psnr)
        _check_logged("history.logged", row.logged)
    _check_logged("logged", state.logged)
    _check_psnr("psnr", state.psnr)
    check_number("wall_s", state.wall_s, least=0)
    check_number("cpu_s", state.cpu_s, least=0)


def _check_psnr(where: str, value: object) -> None:
    if value is not None:
        check_number(where, value)


def _check_logged(where: str, logged: Any) -> None:
    check_kind(where, logged, dict)
    for name, value in logged.items():
        check_kind(where, name, str)
        check_kind(f"{where} {name:.40}", value, int, float)
        if type(value) is int:  # a float may be NaN; an int must fit into one
            check_number(f"{where} {name:.40}", value)


def _check_plugins(state: FieldState, training: TrainingSet, plugins: Mapping[str, Plugin]) -> None:
    kept: Any = state.plugins
    check_kind("plugins", kept, dict)
    if set(kept) != set(plugins):
        raise ValueError(f"plugins: expected {', '.join(plugins)}, got {list(kept)!s:.80}")
    for group, plugin in plugins.items():
        check_kind(group, kept[group], PluginState)
        check_kind(f"{group}.started", kept[group].started, bool)
        value = kept[group].value
        if not kept[group].started:
            check_kind(f"{group}, which has not begun", value, type(None))
            continue
        try:
            plugin.check_state(value, state.gaussians, state.version, training.views)
        except FOREIGN as error:
            raise ValueError(f"{group}: {type(error).__name__}: {error}") from error
