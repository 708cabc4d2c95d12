"""Who may import whom, read from the import statements."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

from framework.command.config.schema import ROOT

FRAMEWORK = sorted((ROOT / "framework").rglob("*.py"))
PLUGINS = sorted((ROOT / "plugins").rglob("*.py"))
REPORT = sorted((ROOT / "framework" / "report").rglob("*.py"))

PLUGIN_MAY_IMPORT = {
    f"framework.{name}"
    for name in (
        *("plugin", "types", "shapes", "geometry", "warp", "warping", "fisher", "information"),
        *("dropout", "pull", "rounds", "bands", "losses", "errors", "registry"),
    )
}
REPORT_MUST_NOT_IMPORT = {
    *("torch", "numba", "plugins"),
    *(f"framework.{name}" for name in ("trainer", "experiment", "rasterize", "types", "ply")),
}
HEAVY = {"torch", "numba", "scipy", "skimage", "cv2", "kornia", "pycolmap", "pandas", "matplotlib"}


def imported(tree: ast.AST) -> Iterator[str]:
    """The full names of all modules that the statements under `tree` import."""
    for statement in ast.walk(tree):
        if isinstance(statement, ast.Import):
            yield from (alias.name for alias in statement.names)
        elif isinstance(statement, ast.ImportFrom):
            assert statement.level == 0, "imports are absolute here"
            module = statement.module or ""
            if module == "framework":
                yield from (f"framework.{alias.name}" for alias in statement.names)
            else:
                yield module


def at_import_time(path: Path) -> Iterator[str]:
    """The modules that importing `path` imports: not under TYPE_CHECKING, not in functions."""
    for statement in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(statement, ast.Import | ast.ImportFrom):
            yield from imported(statement)


def loaded(path: Path, seen: set[Path]) -> Iterator[str]:
    """All modules that importing `path` loads, through the project's own."""
    seen.add(path)
    for module in at_import_time(path):
        yield module
        own = ROOT / Path(*module.split("."))
        for file in (own.with_suffix(".py"), own / "__init__.py"):
            if file.is_file() and file not in seen:
                yield from loaded(file, seen)


def covers(rule: str, module: str) -> bool:
    return module == rule or module.startswith(f"{rule}.")


def everything(path: Path) -> list[str]:
    return list(imported(ast.parse(path.read_text(encoding="utf-8"))))


def name_of(path: Path) -> str:
    return str(path.relative_to(ROOT))


@pytest.mark.parametrize("path", FRAMEWORK, ids=name_of)
def test_the_framework_imports_no_plugin(path: Path) -> None:
    assert not [module for module in everything(path) if covers("plugins", module)]


@pytest.mark.parametrize("path", FRAMEWORK, ids=name_of)
def test_the_framework_names_no_plugin_module(path: Path) -> None:
    packages = {"plugins.augment", "plugins.regularize", "plugins.capacity"}
    tree = ast.parse(path.read_text(encoding="utf-8"))
    texts = {node.value for node in ast.walk(tree) if isinstance(node, ast.Constant)}
    named = {text for text in texts if isinstance(text, str) and text.startswith("plugins.")}
    assert named <= packages


@pytest.mark.parametrize("path", PLUGINS, ids=name_of)
def test_a_plugin_imports_only_its_contracts(path: Path) -> None:
    ours = [module for module in everything(path) if covers("framework", module)]
    assert not [m for m in ours if not any(covers(rule, m) for rule in PLUGIN_MAY_IMPORT)]
    assert not [module for module in everything(path) if covers("plugins", module)]


@pytest.mark.parametrize("path", PLUGINS, ids=name_of)
def test_a_plugin_is_light_to_import(path: Path) -> None:
    assert not {module.partition(".")[0] for module in loaded(path, set())} & HEAVY


@pytest.mark.parametrize("path", REPORT, ids=name_of)
def test_the_report_reads_records_only(path: Path) -> None:
    found = everything(path)
    assert not [m for m in found if any(covers(rule, m) for rule in REPORT_MUST_NOT_IMPORT)]
