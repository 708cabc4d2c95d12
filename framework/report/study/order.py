"""In which order a report names methods and scenes."""

from __future__ import annotations

BASELINE = "none + none"


def method_order(method: str) -> tuple[bool, bool, list[tuple[int, float, str]]]:
    """Sort key: plain `none + none`, then its variants, then the others by name."""
    return method != BASELINE, not method.startswith(BASELINE), natural(method)


def natural(text: str) -> list[tuple[int, float, str]]:
    """Sort key by which `n=9` comes before `n=10`."""
    parts: list[tuple[int, float, str]] = []
    for word in text.replace("=", " = ").replace(")", " )").replace(",", " ,").split():
        try:
            parts.append((0, float(word), ""))
        except ValueError:
            parts.append((1, 0.0, word))
    return parts
