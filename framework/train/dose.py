"""How much of its methods a training got, counted as it goes and told in the run's record.

A method that is chosen may still hardly act: pseudo views are refused, a dropout rate rounds to
nothing, a loss is outweighed. So every occasion is counted, and a checkpoint holds the counts.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

from framework.metrics.values import LARGEST

Tallies = Mapping[str, tuple[int, float]]  # name -> how often, and the sum of what was added
Told = dict[str, float | str]

REFUSED = "refused_"
NONE = (0, 0.0)
NEVER = "never asked"


class Dose:
    """The tallies of one training."""

    def __init__(self) -> None:
        self._tallies: dict[str, tuple[int, float]] = {}

    def open(self, *names: str) -> None:
        """Name what may happen, so that it is told also if it never does."""
        for name in names:
            self._tallies.setdefault(name, NONE)

    def add(self, name: str, value: float = 0.0) -> None:
        """Once more, with this value."""
        count, total = self[name]
        self._tallies[name] = count + 1, total + float(value)

    def __getitem__(self, name: str) -> tuple[int, float]:
        return self._tallies.get(name, NONE)

    def kept(self) -> dict[str, tuple[int, float]]:
        """What a checkpoint holds."""
        return dict(self._tallies)

    def load(self, kept: Tallies) -> None:
        """Go on from what a checkpoint held."""
        self._tallies = dict(kept)


def joined(parts: Iterable[Tallies]) -> Tallies:
    """Of several trainings as one."""
    whole: dict[str, tuple[int, float]] = {}
    for part in parts:
        for name, (count, total) in part.items():
            before = whole.get(name, NONE)
            whole[name] = before[0] + count, before[1] + total
    return whole


def told(of: Tallies) -> Told:
    """What a record tells, empty without a method; a text stands where there is no number.

    Of an augmenter: `views_asked`, the epochs that asked for a pseudo view; `views_made`, the
    views that these gave to train on; `refused_WHY`, epochs without one, by what the plugin logged
    last as the reason, and `refused_other`; `NAME_mean` of all else that it logged (of a warping
    one `coverage`, of the frame, `coverage_of_depth`, `supports`, `support_distance`, `nearest`,
    that the nearest photo is one of them, `support_rank`, their mean place by nearness);
    `pseudo_share_of_loss`, the pseudo views' weighted photometric losses over those of all views;
    `pseudo_share_of_views`, the same of the number of renders. Of a regularizer: `NAME_mean` of
    what it logged; of one that drops, `share_dropped_mean`, the share of Gaussians with a smaller
    opacity, mean over all training steps; of several regularizers each of these begins with the
    plugin's name. `augment_acted_share`, `reg_acted_share`: of the
    occasions on which it was asked (epochs, steps), those on which it acted; `acted_share`: the
    smaller one.
    """
    found = _of_augmenter(of) if "augment.asked" in of else {}
    for owner in sorted(name.removesuffix(".asked") for name in of if name.endswith(".asked")):
        if owner.partition(".")[0] == "reg":
            found |= _of_regularizer(of, owner)
    shares = [value for name, value in found.items() if name.endswith("_acted_share")]
    if shares:
        numbers = [value for value in shares if isinstance(value, float)]
        found["acted_share"] = NEVER if len(numbers) < len(shares) else min(numbers)
    return found


def _of_augmenter(of: Tallies) -> Told:
    asked, acted = of["augment.asked"]
    found: Told = {"views_asked": asked, "views_made": of.get("augment.views", NONE)[0]}
    logged = _logged(of, "augment")
    refused = {name: count for name, (count, _) in logged.items() if name.startswith(REFUSED)}
    left = asked - int(acted) - sum(refused.values())
    found |= {f"{REFUSED}coverage": 0, **refused, f"{REFUSED}other": max(0, left)}
    found |= _means({name: tally for name, tally in logged.items() if name not in refused})
    real, pseudo = (of.get(f"loss.{kind}", NONE) for kind in ("real", "pseudo"))
    found["pseudo_share_of_loss"] = _ratio(pseudo[1], real[1] + pseudo[1])
    found["pseudo_share_of_views"] = _ratio(pseudo[0], real[0] + pseudo[0])
    return found | {"augment_acted_share": _ratio(acted, asked)}


def _of_regularizer(of: Tallies, owner: str) -> Told:
    found = _means(_logged(of, owner))
    if f"{owner}.dropped" in of:
        found["share_dropped_mean"] = _ratio(of[f"{owner}.dropped"][1], of.get("steps", NONE)[0])
    acted = of.get(f"{owner}.acted", NONE)[0]
    found["acted_share"] = _ratio(acted, of[f"{owner}.asked"][0])
    several = owner.partition(".")[2]
    if several:
        return {f"{several}_{name}": value for name, value in found.items()}
    return found | {"reg_acted_share": found.pop("acted_share")}


def _logged(of: Tallies, group: str) -> dict[str, tuple[int, float]]:
    """What the plugin of `group` logged, by its own names."""
    start = f"log.{group}."
    return {name.removeprefix(start): of[name] for name in sorted(of) if name.startswith(start)}


def _means(tallies: Tallies) -> Told:
    return {f"{name}_mean": _ratio(total, count) for name, (count, total) in tallies.items()}


def _ratio(part: float, whole: float) -> float | str:
    if whole == 0:
        return NEVER
    ratio = part / whole
    if abs(ratio) <= LARGEST:
        return ratio
    return f"beyond {LARGEST:g}" if math.isfinite(ratio) else "not finite"
