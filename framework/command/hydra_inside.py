"""All uses of Hydra's private modules, and why they are needed.

- The argument parser: flags are checked before Hydra composes anything, with our messages.
- The split of a sweep into runs: all runs are checked before the first one, so both must split
  alike. Hydra's sweeper then need not compose every run once more, a tenth of a second each.
- The store of choices is a plain dictionary; a choice of several plugins, `reg=uar+depth_rank`, is
  made on demand.

`tests/cli/test_hydra_inside.py` fails if a newer Hydra changes one of them.
"""

from __future__ import annotations

from argparse import ArgumentParser
from collections.abc import Mapping, Sequence
from typing import Any

from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra._internal.utils import get_args_parser
from hydra.core.config_store import ConfigNode
from hydra.core.override_parser.types import Override
from omegaconf import OmegaConf

from framework.registry import JOINED_BY, parts_of


def argument_parser() -> ArgumentParser:
    """Return a parser of Hydra's flags and of overrides."""
    parser: ArgumentParser = get_args_parser()
    return parser


def jobs_of(overrides: Sequence[Override]) -> list[list[str]]:
    """Return the overrides of every run of a sweep, in the order of Hydra's basic sweeper."""
    batches = BasicSweeper.split_arguments(list(overrides), None)
    return [list(job) for batch in batches for job in batch]


def skip_second_check() -> None:
    """Keep Hydra's sweeper from composing all runs, which this program has done already."""
    setattr(BasicSweeper, "validate_batch_is_legal", lambda sweeper, batch: None)  # noqa: B010


class JoinedChoices(dict[str, Any]):
    """The nodes of a group in Hydra's ConfigStore, with a node for every `a+b.yaml` on demand.

    Such a node composes its parts into separate packages `reg.a`, `reg.b`, with the values that
    presets set. So a part may be a variant from a YAML file, such as `uar_hard`.
    """

    def __init__(self, group: str, nodes: Mapping[str, Any]) -> None:
        super().__init__(nodes)
        self.group = group

    def __contains__(self, file: object) -> bool:
        return super().__contains__(file) or (isinstance(file, str) and JOINED_BY in file)

    def __missing__(self, file: str) -> ConfigNode:
        name, group = file.removesuffix(".yaml"), self.group
        defaults: list[Any] = []
        for part in parts_of(group, name):
            defaults.append({f"/{group}@{part}": part})
            preset = f"optional /for_preset/{group}@{part}"
            defaults.append({preset: f"${{preset}}_{part}"})
        node = OmegaConf.create({"defaults": [*defaults, "_self_"], "name": name})
        return ConfigNode(file, node, group, None, "fishersplat")
