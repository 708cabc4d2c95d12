"""Benchmarks are run by hand: what they name in the framework must still be there."""

import ast
import functools
import importlib
import re
from pathlib import Path

import pytest

from framework.command.config.schema import ROOT

SCRIPTS = sorted((ROOT / "benchmarks").rglob("*.py"))
STAGE = re.compile(r"(framework(?:\.\w+)+):((?:\w+\.)*\w+)")


def places() -> set[tuple[str, str]]:
    """(module, name) of every text `module:name` in a benchmark."""
    texts = (
        node.value
        for path in SCRIPTS
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    )
    return {(actual[1], actual[2]) for text in texts if (actual := STAGE.fullmatch(text))}


@pytest.mark.parametrize(("module", "name"), sorted(places()))
def test_what_is_timed_exists(module: str, name: str) -> None:
    functools.reduce(getattr, name.split("."), importlib.import_module(module))


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: path.name)
def test_what_is_imported_or_called_of_a_module_exists(path: Path) -> None:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    modules = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("framework"):
            owner = importlib.import_module(str(node.module))
            for alias in node.names:
                whole = f"{node.module}.{alias.name}"
                if not hasattr(owner, alias.name):
                    modules[alias.asname or alias.name] = importlib.import_module(whole)
                elif isinstance(getattr(owner, alias.name), type(importlib)):
                    modules[alias.asname or alias.name] = getattr(owner, alias.name)
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            module = modules.get(node.value.id)
            assert module is None or hasattr(module, node.attr), ast.unparse(node)
