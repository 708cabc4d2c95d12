"""The meaning of options in a line, for `--help`.

It is the comment behind the field, `eta: float = 1.5  # ...`, or in the docstring of the class,
`eta: meaning. every, until: meaning of both.` Subclasses inherit meanings.
"""

from __future__ import annotations

import dataclasses
import re
import sys
import textwrap
from pathlib import Path

WIDTH = 100  # characters of a meaning


def meanings(cls: type) -> dict[str, str]:
    """option -> meaning, of the options of a dataclass that have one."""
    texts: dict[str, str] = {}
    options = {option.name for option in dataclasses.fields(cls)}
    for base in reversed([b for b in cls.__mro__ if dataclasses.is_dataclass(b)]):
        texts |= _from_docstring(vars(base).get("__doc__") or "", options)
        texts |= _from_comments(_source(base), options)
    return texts


def from_yaml(text: str) -> dict[str, str]:
    """key -> the comment behind it, for the keys of a YAML file."""
    lines = re.findall(r"^ *(\w+):[^#\n]* # (.+)$", text, re.MULTILINE)
    return {name: _line(comment) for name, comment in lines}


def _source(cls: type) -> str:
    """The source of a top-level class, or "". `inspect.getsource` would parse the module, which is
    slow."""
    file = getattr(sys.modules.get(cls.__module__), "__file__", None) or ""
    try:
        text = Path(file).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return ""
    match = re.search(rf"^class {cls.__name__}\b.*?(?=^\S|\Z)", text, re.MULTILINE | re.DOTALL)
    return match.group() if match else ""


def _from_comments(source: str, options: set[str]) -> dict[str, str]:
    lines = re.findall(r"^    (\w+): [^#\n]*  # (.+)$", source, re.MULTILINE)
    return {name: _line(comment) for name, comment in lines if name in options}


def _from_docstring(text: str, options: set[str]) -> dict[str, str]:
    texts: dict[str, str] = {}
    name = f"(?:{'|'.join(map(re.escape, sorted(options)))})" if options else "(?!)"
    parts = re.split(rf"(?:^|(?<=\s))({name}(?:, {name})*): ", " ".join(text.split()))
    for names, said in zip(parts[1::2], parts[2::2], strict=True):
        sentence = re.split(r"\.(?=\s+[A-Z])", said)[0]
        texts |= dict.fromkeys(names.split(", "), _line(sentence))
    return texts


def _line(text: str) -> str:
    return textwrap.shorten(text.replace("`", "").rstrip(" .;"), WIDTH, placeholder=" ...")
