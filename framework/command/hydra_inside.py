"""The one place that reaches into Hydra's private modules, and why.

Hydra has no public name for its argument parser: its flags are needed before Hydra composes
anything, to refuse what a stranger's line may not ask for, and an error is told in our words. Nor
has it one for how its sweeper splits overrides into runs: the runs are checked before the first
begins, so both must split alike. `tests/cli/test_hydra_inside.py` says what breaks with a newer
Hydra.
"""

from __future__ import annotations

from argparse import ArgumentParser
from collections.abc import Sequence

from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra._internal.utils import get_args_parser
from hydra.core.override_parser.types import Override


def argument_parser() -> ArgumentParser:
    """A parser of Hydra's flags and of the overrides beside them."""
    parser: ArgumentParser = get_args_parser()
    return parser


def jobs_of(overrides: Sequence[Override]) -> list[list[str]]:
    """The overrides of every run of a sweep, in the order of Hydra's basic sweeper."""
    batches = BasicSweeper.split_arguments(list(overrides), None)
    return [list(job) for batch in batches for job in batch]
