"""What all depth providers are: measured maps, and a corruption for stress studies on top.

A provider implements `measure` and `fingerprint`; its users call `estimate`. Importing this module
loads neither torch nor numba.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from framework.errors import check_option, nearest_hint, require

if TYPE_CHECKING:
    from framework.types import DepthMap, TrainingSet

NONE = "none"
CORRUPTIONS = ("noise", "bias", "holes", "blur")
DEFAULT_STRENGTH = 0.5


@dataclass(frozen=True, kw_only=True)
class DepthProvider:
    """Base of all providers, with the options they share.

    Attributes:
        corruption: none, or noise, bias, holes, blur, several joined by + in the order they act.
            For instance `noise+holes`.
        strength: of all corruptions, in [0, 1]; 0 changes nothing. 1 is as bad as
            `framework.depth.corruption` says.
        corruption_seed: of their draws. The run's seed does not move them: all seeds of a study
            meet the same spoiled depth.
    """

    corruption: str = NONE
    strength: float = DEFAULT_STRENGTH
    corruption_seed: int = 0

    def __post_init__(self) -> None:
        for kind in self.corruptions():
            require(
                kind in CORRUPTIONS,
                f"depth.corruption: unknown corruption '{kind}'; {nearest_hint(kind, CORRUPTIONS)},"
                f" several joined by +, or {NONE}",
            )
        self.check("strength", 0 <= self.strength <= 1, "a number in [0, 1]")
        require(
            self.strength == DEFAULT_STRENGTH or self.corruption != NONE,
            "depth.strength: it is the strength of a corruption, and depth.corruption is none; add"
            f" depth.corruption=KIND ({', '.join(CORRUPTIONS)}) or drop depth.strength",
        )
        self.check("corruption_seed", self.corruption_seed >= 0, "an integer >= 0")

    def check(self, option: str, ok: bool, expected: str) -> None:
        """Raise UserError, with the option's value and what it should be, unless `ok`."""
        check_option(self, "depth", option, ok, expected)

    def corruptions(self) -> tuple[str, ...]:
        """The chosen corruptions in the order they act."""
        return () if self.corruption == NONE else tuple(self.corruption.split("+"))

    def ready(self) -> None:
        """Raise UserError, in one line, where this machine lacks what the provider needs. Quick:
        studies ask before their first run. Most need nothing."""

    def learned_weights(self) -> str:
        """Return the weights of a network that was trained on other scenes; "" if there is none.

        Results that used such weights are reported separately.
        """
        return ""

    def estimate(self, training: TrainingSet) -> tuple[DepthMap, ...]:
        """One map per training view, in their order, corrupted as the options say."""
        maps = self.measure(training)
        if not self.corruptions() or self.strength == 0:
            return maps
        from framework.depth.corruption import corrupt

        return corrupt(maps, self.corruptions(), self.strength, self.corruption_seed)

    def measure(self, training: TrainingSet) -> tuple[DepthMap, ...]:
        """One map per training view, in their order, as well as the provider can."""
        raise NotImplementedError

    def fingerprint(self, training: TrainingSet) -> str:
        """What beside the options and the training set determines the maps: SHA-256 hex of the
        files that `measure` reads, "" if it reads none."""
        return ""


def unspoiled(options: Mapping[str, Any]) -> dict[str, Any]:
    """The options of the same provider without its corruption; the same where it has none."""
    if options.get("corruption", NONE) == NONE:
        return dict(options)
    spoils = ("corruption", "strength", "corruption_seed")
    return {name: value for name, value in options.items() if name not in spoils}
