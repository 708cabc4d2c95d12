"""Compose the configuration of a single run from the words of the command line."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hydra import compose, initialize_config_dir

from framework.command.complaints import USER_ERRORS, composing, one_line
from framework.command.config.check import check
from framework.command.config.naming import plain, register_resolvers, run_name, study_name
from framework.command.config.schema import CONF_DIR, register_config
from framework.command.overrides import normalise
from framework.errors import UserError, require
from framework.records import RUN_FOLDERS


@dataclass(frozen=True)
class Configuration:
    """A checked configuration of one run.

    Attributes:
        values: resolved options by group.
        folder: `reports/STUDY/runs/NAME`, as on the command line.
        options: the words that it was composed from.
    """

    values: dict[str, Any]
    folder: Path
    options: tuple[str, ...]


def configuration(options: Sequence[str]) -> Configuration:
    """Compose and check a configuration.

    Args:
        options: words of the command line, for instance `augment=safi` or `trainer.steps=300`.

    Raises:
        UserError: An option is unknown or invalid, or describes more than one run.
    """
    words = normalise(options)
    flags = [word for word in words if word.startswith("-")]
    require(not flags, f"run: expected options as KEY=VALUE, got the flag '{' '.join(flags)}'")
    register_config()
    register_resolvers()
    try:
        with composing(), initialize_config_dir(config_dir=str(CONF_DIR), version_base="1.3"):
            composed = compose("config", words, return_hydra_config=True)
    except USER_ERRORS as error:
        raise UserError(one_line(error)) from None
    values = plain(composed)
    check(values)
    values["study"] = study_name(values)
    choices = composed.hydra.runtime.choices
    name = run_name(values, str(choices.augment), str(choices.reg))
    return Configuration(values, Path("reports", values["study"], RUN_FOLDERS, name), tuple(words))
