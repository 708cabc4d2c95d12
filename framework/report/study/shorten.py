"""Short names of capacities: of options that were always changed together, one is enough to tell
which is meant; what went with it is told once, in a note."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace

from framework.report.study.labels import MethodLabel, listed

Options = Mapping[str, str]


def shortened(labels: Sequence[MethodLabel]) -> tuple[dict[str, MethodLabel], list[str]]:
    """Name -> its label with fewer options of its capacity, still one for each; and the notes."""
    by_capacity: dict[str, dict[str, Options]] = defaultdict(dict)
    for label in labels:
        name, *parts = label.capacity.split(", ")
        pairs = (option.partition("=") for option in parts)
        by_capacity[name][label.capacity] = {key: value for key, _, value in pairs}
    short: dict[str, str] = {}
    notes = []
    for name, texts in by_capacity.items():
        kept = _telling(list(texts.values()))
        for text, options in texts.items():
            told = [f"{key}={options[key]}" for key in kept if key in options]
            beside = [f"{key}={value}" for key, value in options.items() if key not in kept]
            short[text] = ", ".join((name, *told)) if beside else text
            if beside:
                notes.append(f"{short[text]} ran with {listed(beside, 'and')}")
    named = {label.full: replace(label, capacity=short[label.capacity]) for label in labels}
    return named, [f"Short names: {'; '.join(notes)}."] if notes else []


def _telling(found: Sequence[Options]) -> list[str]:
    """The keys that tell the options apart, words before numbers; a key that one of them follows
    from is left out. All keys, where options have different ones."""
    keys = list(dict.fromkeys(key for options in found for key in options))
    if len(found) < 2 or any(options.keys() != set(keys) for options in found):
        return keys
    kept: list[str] = []
    for key in sorted(keys, key=lambda key: _numeric(found[0][key])):
        if not any(_follows(key, other, found) for other in kept):
            kept.append(key)
    return kept


def _follows(key: str, other: str, found: Sequence[Options]) -> bool:
    """Whether the value of `other` says that of `key`."""
    seen: dict[str, set[str]] = defaultdict(set)
    for options in found:
        seen[options[other]].add(options[key])
    return len(seen) > 1 and all(len(values) == 1 for values in seen.values())


def _numeric(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
