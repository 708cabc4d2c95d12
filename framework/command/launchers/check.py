"""What a configuration may ask of a launcher.

A launcher starts processes, on a cluster with the user's account, so one that leaves this machine
is chosen on the command line alone, by its name, with plain values; a shell line for its jobs
(`setup`), a folder or free options for `sbatch` are none.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

from hydra.errors import HydraException

from framework.command.launchers.known import LAUNCHERS, Known, stored
from framework.errors import require
from framework.files import limits

# no space, quote or newline: the texts end up in the head of a shell script
PLAIN = re.compile(r"[\w.,:=+/@%\[\]-]{1,200}", re.ASCII)


def check_launcher(got: Mapping[str, Any], typed: Sequence[str]) -> None:
    """Raise UserError unless Hydra's part `launcher` is one of ours with options that are allowed.
    typed: the command line's words about Hydra."""
    target = got.get("_target_")
    for name, launcher in LAUNCHERS.items():
        declared = _declared(name)
        if declared and declared["_target_"] == target:
            _check(name, launcher, _flat(got), _flat(declared), typed)
            return
    title = " or ".join(f"hydra/launcher={name}" for name in LAUNCHERS)
    require(False, f"hydra.launcher: expected {title}, got {str(target)[:100]!r}; choose one")


def _check(
    name: str,
    launcher: Known,
    got: Mapping[str, Any],
    declared: Mapping[str, Any],
    typed: Sequence[str],
) -> None:
    changed = [key for key in got if key not in declared or got[key] != declared[key]]
    odd = [key for key in changed if key not in launcher.options]
    options = ", ".join(launcher.options) or "at all"
    require(
        not odd,
        f"hydra.launcher.{odd[0] if odd else ''}: expected no option but {options}, got one;"
        " remove it",
    )
    if "n_jobs" in got:
        _check_jobs(got["n_jobs"])
    if not launcher.remote:
        return
    words = [word.lstrip("+") for word in typed]
    keys = {word.partition("=")[0] for word in words}
    for key, word in [("", "hydra/launcher"), *((f".{k}", f"hydra.launcher.{k}") for k in changed)]:
        require(
            word in keys,
            f"hydra.launcher{key}: expected {name} and its options on the command line only, got"
            " it from a configuration file; remove it there",
        )
    for key in changed:
        _check_value(f"hydra.launcher.{key}", got[key])


def _check_value(key: str, value: Any) -> None:
    number = isinstance(value, int | float) and -1 <= value <= 1e15
    text = isinstance(value, str) and PLAIN.fullmatch(value) is not None
    require(
        value is None or number or text,
        f"{key}: expected a number or a word of letters, digits and . , : = + / @ % - [ ], got"
        f" {str(value)[:100]!r}; choose another",
    )


def _check_jobs(n_jobs: Any) -> None:
    fits = isinstance(n_jobs, int) and -limits.PARALLEL_RUNS <= n_jobs <= limits.PARALLEL_RUNS
    require(
        fits and n_jobs != 0,
        f"hydra.launcher.n_jobs: expected 1 to {limits.PARALLEL_RUNS} processes, or -1 for one per"
        f" core, got {n_jobs!r}; choose a number",
    )


def _declared(name: str) -> dict[str, Any]:
    """Empty for one that is not installed."""
    try:
        return stored(name)
    except (HydraException, OSError):
        return {}


def _flat(options: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Dotted keys to what is no mapping."""
    found: dict[str, Any] = {}
    for key, value in options.items():
        inner = isinstance(value, Mapping) and value
        found |= _flat(value, f"{prefix}{key}.") if inner else {f"{prefix}{key}": value}
    return found
