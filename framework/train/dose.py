"""Counts how much the methods of a training acted, for the run's record.

A chosen method may hardly act: pseudo views are refused, a dropout rate rounds to 0, a loss is
outweighed. So every call is counted; checkpoints hold the counts.
"""

import math
from collections.abc import Iterable, Mapping

from framework.metrics.values import LARGEST

Tallies = Mapping[str, tuple[int, float]]  # name -> how often, and the sum of what was added
Summary = dict[str, float | str]

REFUSED = "refused_"
NONE = (0, 0.0)
NEVER = "never asked"


class Dose(dict[str, tuple[int, float]]):
    """The tallies of one training. A name that is set to `NONE` is recorded even if it stays so."""

    def __missing__(self, name: str) -> tuple[int, float]:
        return NONE

    def add(self, name: str, value: float = 0.0, times: int = 1) -> None:
        """Count one more, with this value."""
        count, total = self[name]
        self[name] = count + times, total + float(value)


def joined(parts: Iterable[Tallies]) -> Tallies:
    """The tallies of several trainings together."""
    whole = Dose()
    for part in parts:
        for name, (count, total) in part.items():
            whole.add(name, total, count)
    return dict(whole)


def summary(of: Tallies) -> Summary:
    """Return the record's counts, empty without a method; texts replace undefined numbers.

    Augmenter:
        views_asked: epochs that called it.
        views_made: pseudo views that were trained on.
        refused_WHY: epochs without a view, by the last reason logged; refused_other for the rest.
        NAME_mean: mean of every other value that it logged.
        pseudo_share_of_loss: pseudo views' share of the weighted photometric losses.
        pseudo_share_of_views: the same of the number of renders.

    Regularizer (with several, names begin with the plugin's name):
        NAME_mean: mean of every value that it logged.
        share_dropped_mean: share of Gaussians with a reduced opacity, mean over training steps.

    Both: augment_acted_share and reg_acted_share are the shares of the calls in which the method
    acted; acted_share is the smaller one.
    """
    lines = _of_augmenter(of) if "augment.asked" in of else {}
    for owner in sorted(name.removesuffix(".asked") for name in of if name.endswith(".asked")):
        if owner.partition(".")[0] == "reg":
            lines |= _of_regularizer(of, owner)
    shares = [value for name, value in lines.items() if name.endswith("_acted_share")]
    if shares:
        numbers = [value for value in shares if isinstance(value, float)]
        lines["acted_share"] = NEVER if len(numbers) < len(shares) else min(numbers)
    return lines


def _of_augmenter(of: Tallies) -> Summary:
    asked, acted = of["augment.asked"]
    lines: Summary = {"views_asked": asked, "views_made": of.get("augment.views", NONE)[0]}
    logged = _logged(of, "augment")
    refused = {name: count for name, (count, _) in logged.items() if name.startswith(REFUSED)}
    left = asked - int(acted) - sum(refused.values())
    lines |= {f"{REFUSED}coverage": 0, **refused, f"{REFUSED}other": max(0, left)}
    lines |= _means({name: tally for name, tally in logged.items() if name not in refused})
    real, pseudo = (of.get(f"loss.{kind}", NONE) for kind in ("real", "pseudo"))
    lines["pseudo_share_of_loss"] = _ratio(pseudo[1], real[1] + pseudo[1])
    lines["pseudo_share_of_views"] = _ratio(pseudo[0], real[0] + pseudo[0])
    return lines | {"augment_acted_share": _ratio(acted, asked)}


def _of_regularizer(of: Tallies, owner: str) -> Summary:
    lines = _means(_logged(of, owner))
    if f"{owner}.dropped" in of:
        lines["share_dropped_mean"] = _ratio(of[f"{owner}.dropped"][1], of.get("steps", NONE)[0])
    acted = of.get(f"{owner}.acted", NONE)[0]
    lines["acted_share"] = _ratio(acted, of[f"{owner}.asked"][0])
    several = owner.partition(".")[2]
    if several:
        return {f"{several}_{name}": value for name, value in lines.items()}
    return lines | {"reg_acted_share": lines.pop("acted_share")}


def _logged(of: Tallies, group: str) -> dict[str, tuple[int, float]]:
    """What the plugin of `group` logged, by its own names."""
    start = f"log.{group}."
    return {name.removeprefix(start): of[name] for name in sorted(of) if name.startswith(start)}


def _means(tallies: Tallies) -> Summary:
    return {f"{name}_mean": _ratio(total, count) for name, (count, total) in tallies.items()}


def _ratio(part: float, whole: float) -> float | str:
    if whole == 0:
        return NEVER
    ratio = part / whole
    if abs(ratio) <= LARGEST:
        return ratio
    return f"beyond {LARGEST:g}" if math.isfinite(ratio) else "not finite"
