"""Which plugin files a run depends on, so that editing another plugin does not repeat it."""

from __future__ import annotations

import ast
import functools
import hashlib
import importlib.util
import os
import sys
from collections.abc import Iterator, Mapping, Set
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, NamedTuple

from framework import registry
from framework.files.paths import ENTRY_POINTS, OWN_VARIABLE, own_plugins
from framework.records.provenance import ROOT
from framework.registry import FOLDER

# names in a file that may import, or find, code without naming its file
DYNAMIC = {"importlib", "__import__", "exec", "eval", "runpy", "pkgutil", "registry", "*"}


def chosen_plugins(config: Mapping[str, Any]) -> dict[str, type]:
    """Return `group=NAME` -> class of every plugin and part that the run uses."""
    classes: dict[str, type] = {}
    for group in (*registry.GROUPS, *registry.PARTS):
        chosen = config["metrics"].get("also") if group == "metric" else config[group]["name"]
        for name in str(chosen).split(registry.JOINED_BY) if chosen else ():
            cls = registry.table(group).get(name)
            if cls is not None:
                classes[f"{group}={name}"] = cls
    return classes


def plugin_hashes(config: Mapping[str, Any]) -> dict[str, str]:
    """Return `group=NAME` -> SHA-256 of the plugin's file and of the plugin files it imports.

    Parts of the framework itself, which its own hash covers, are left out.
    """
    return {
        name: _hash(cls)
        for name, cls in chosen_plugins(config).items()
        if cls.__module__.partition(".")[0] != "framework"
    }


def _hash(cls: type) -> str:
    sources = _sources(os.environ.get(OWN_VARIABLE))
    start = Path(str(sys.modules[cls.__module__].__file__)).resolve()
    files = _imported(start, sources) if start in sources else ()
    digest = hashlib.sha256()
    for source in sorted(sources[file] for file in files):
        digest.update(f"{source.name}\0".encode() + hashlib.sha256(source.content).digest())
    return digest.hexdigest()


class _Source(NamedTuple):
    """A plugin file as it was imported. tree: name of the folder or package it came from."""

    name: str
    content: bytes
    tree: str


@functools.cache
def _sources(own_folder: str | None) -> dict[Path, _Source]:
    """Read every plugin file once per process: edits during a study do not change running code."""
    sources = [(file, "", file.relative_to(ROOT).as_posix()) for file in FOLDER.rglob("*.py")]
    sources += [(file, "own", f"own {place}") for place, file in own_plugins()]
    for point in entry_points(group=ENTRY_POINTS):
        package = point.module.partition(".")[0]
        spec = importlib.util.find_spec(package)
        for folder in map(Path, (spec and spec.submodule_search_locations) or ()):
            sources += [
                (f, package, f"{package}/{f.relative_to(folder)}") for f in folder.rglob("*.py")
            ]
        if spec and spec.origin and not spec.submodule_search_locations:
            sources.append((Path(spec.origin), package, package))
    return {file.resolve(): _Source(name, file.read_bytes(), tree) for file, tree, name in sources}


def _imported(start: Path, sources: Mapping[Path, _Source]) -> set[Path]:
    """Return `start` and the files that it may import, directly or not.

    Errs on the side of too many: a file counts as imported if a module of its name is, and all do
    where the source does not name them. An installed package counts as a whole.
    """
    if sources[start].tree not in ("", "own"):
        return {file for file in sources if sources[file].tree == sources[start].tree}
    imported, todo = set[Path](), [start]
    while todo:
        file = todo.pop()
        if file not in imported:
            imported.add(file)
            names = set(_names(sources[file].content))
            todo += [f for f in sources if names & DYNAMIC or _may_be(f, names, file)]
    return imported


def _may_be(other: Path, names: Set[str], importer: Path) -> bool:
    if other.stem == "__init__":
        return other.parent.name in names or other.parent in importer.parents
    return other.stem in names


def _names(content: bytes) -> Iterator[str]:
    """Yield the parts of the modules that a source imports, and the dynamic names that it uses."""
    try:
        tree = ast.parse(content)
    except (SyntaxError, ValueError):
        yield "*"
        return
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield from alias.name.split(".")
        elif isinstance(node, ast.ImportFrom):
            names = [*(node.module or "").split("."), *(alias.name for alias in node.names)]
            if names[0] != "framework" or "registry" in names:
                yield from names
        elif isinstance(node, ast.Name) and node.id in DYNAMIC:
            yield node.id
