"""File names made of names from outside. Letters' case tells no two of them apart, as some disks do
not tell it either."""

from __future__ import annotations

import hashlib
import re
from collections import Counter
from collections.abc import Iterable

LENGTH = 120  # characters


def file_names(texts: Iterable[str]) -> dict[str, str]:
    """A part of a file name for each of the `texts`: its slug, with a hash of the text where
    another one has that slug too."""
    slugs = {text: slug(text) for text in texts}
    times = Counter(name.lower() for name in slugs.values())
    return {
        text: name if times[name.lower()] == 1 else _with_hash(name, text)
        for text, name in slugs.items()
    }


def slug(text: str) -> str:
    """`text` as part of a file name; where that would lose letters, with a hash of it."""
    name = re.sub(r"[^A-Za-z0-9]+", "_", text).strip("_")
    if name and text.isascii() and len(name) <= LENGTH:
        return name
    return _with_hash(name[:LENGTH], text)


def _with_hash(name: str, text: str) -> str:
    digest = hashlib.sha256(text.encode("utf-8", "replace")).hexdigest()[:8]
    return "_".join(filter(None, (name, digest)))
