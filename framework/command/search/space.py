"""What a search may vary: words of the command line in Hydra's own grammar.

trainer.lr_scale=interval(1.0,10.0)                  a number between two
trainer.opacity_decay=tag(log,interval(0.9,0.999))   the same, evenly in the logarithm
trainer.sh_degree=interval(0,3)                      an integer between two, both included
init=stereo,fused                                    one of several
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from hydra.core.override_parser.types import IntervalSweep, Override

from framework.command.overrides import check_given_twice, parsed
from framework.errors import require

MOST_CHOICES = 1000


@dataclass(frozen=True)
class Dimension:
    """One option that varies: between low and high, or among choices."""

    key: str
    low: float = 0.0
    high: float = 0.0
    whole: bool = False
    log: bool = False
    choices: tuple[str, ...] = ()

    def word(self, trial: Any) -> str:
        """The option with a value that optuna's `trial` suggests."""
        if self.choices:
            return f"{self.key}={trial.suggest_categorical(self.key, self.choices)}"
        if self.whole:
            low, high = int(self.low), int(self.high)
            return f"{self.key}={trial.suggest_int(self.key, low, high, log=self.log)}"
        return f"{self.key}={trial.suggest_float(self.key, self.low, self.high, log=self.log):.6g}"

    @property
    def first(self) -> str:
        """The option with a value of the space."""
        if self.choices:
            return f"{self.key}={self.choices[0]}"
        return f"{self.key}={int(self.low) if self.whole else self.low}"

    def plain(self) -> dict[str, Any]:
        """Return the value for JSON."""
        return {**asdict(self), "choices": list(self.choices)}


def space_of(words: Sequence[str]) -> tuple[list[str], list[Dimension]]:
    """The words that stay, and the options that vary.

    Raises:
        UserError: where none does.
    """
    check_given_twice(words)
    fixed, varied = [], []
    for override in parsed(words):
        if override.is_sweep_override():
            varied.append(_dimension(override))
        else:
            fixed.append(str(override.input_line))
    require(
        len(varied) > 0,
        "search: expected an option that varies, got none; write for instance"
        " 'trainer.lr_scale=interval(1.0,10.0)' or init=stereo,fused",
    )
    return fixed, varied


def _dimension(override: Override) -> Dimension:
    key, value = override.get_key_element(), override.value()
    if not isinstance(value, IntervalSweep):
        choices = tuple(dict.fromkeys(override.sweep_string_iterator()))
        require(
            0 < len(choices) <= MOST_CHOICES,
            f"{override.input_line}: expected 1 to {MOST_CHOICES} values, got {len(choices)}; list"
            " fewer, or give an interval",
        )
        return Dimension(key, choices=choices)
    low, high = value.start, value.end
    assert low is not None and high is not None
    whole = isinstance(low, int) and isinstance(high, int)
    require(
        math.isfinite(low) and math.isfinite(high) and low < high,
        f"{override.input_line}: expected two finite numbers, the smaller first, got others; change"
        " them",
    )
    log = "log" in value.tags
    require(
        not log or low > 0,
        f"{override.input_line}: expected positive numbers for a logarithm, got {low}; raise it",
    )
    return Dimension(key, float(low), float(high), whole, log)
