"""Texts from records and options, made safe to show; lists of names."""

import json
from collections.abc import Mapping, Sequence
from typing import Any

from framework.errors import printable_line

Flat = Mapping[str, Any]


def outside(text: str) -> str:
    """A text from a record as one printable line of bounded length, without backticks."""
    return printable_line(" ".join(text.split())).replace("`", "'")


def code(text: str) -> str:
    """A text from a record in backticks; empty stays empty."""
    line = outside(text)
    return f"`{line}`" if line else ""


def value_text(value: Any) -> str:
    """An option's value as it is shown."""
    return outside(value) if isinstance(value, str) else json.dumps(value)


def flatten(config: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Dotted keys of a nested configuration."""
    flat: dict[str, Any] = {}
    for key, value in config.items():
        if isinstance(value, Mapping):
            flat |= flatten(value, f"{prefix}{key}.")
        else:
            flat[f"{prefix}{key}"] = value
    return flat


def listed(items: Sequence[object], word: str = "and") -> str:
    """`a, b and c`, with `word` before the last one; `a; b, steps=300 and c` if a name has a
    comma."""
    *most, last = map(str, items)
    return f"{joined(most, last)} {word} {last}" if most else last


def joined(items: Sequence[object], last: str = "") -> str:
    """`a, b`; `a; b, steps=300` if a name, or the `last` one that follows, has a comma."""
    texts = list(map(str, items))
    commas = any(", " in text.partition(" (")[0] for text in (*texts, last))
    return ("; " if commas else ", ").join(texts)


def natural(text: str) -> list[tuple[int, float, str]]:
    """Sort key by which `n=9` comes before `n=10`."""
    parts: list[tuple[int, float, str]] = []
    for word in text.replace("=", " = ").replace(")", " )").replace(",", " ,").split():
        try:
            parts.append((0, float(word), ""))
        except ValueError:
            parts.append((1, 0.0, word))
    return parts
