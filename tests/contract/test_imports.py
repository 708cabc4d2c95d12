"""Who may import whom, read from the import statements."""

from __future__ import annotations

import ast
import functools
from collections.abc import Iterator
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

from framework import registry
from framework.command.config.schema import ROOT

FRAMEWORK = sorted((ROOT / "framework").rglob("*.py"))
PLUGINS = sorted((ROOT / "plugins").rglob("*.py"))
REPORT = sorted((ROOT / "framework" / "report").rglob("*.py"))


@functools.cache
def parsed(path: Path) -> ast.Module:
    """The syntax tree of a source file."""
    return ast.parse(path.read_text(encoding="utf-8"))


# Top to bottom: a package may import from those below it, never from above. `__all__` in the
# `__init__.py` of a package lists what others may use, all of it without `__all__`. Comments appear
# in docs/rooms.png.
ROOMS = (
    "command",  # command line -> configurations and runs
    "report",  # records -> findings -> report
    "view",  # one or two runs in the browser
    "exports",  # pictures, videos, files for other programs
    "run",  # scene -> depth -> training -> evaluation -> record
    "train",  # the training loop
    "toolbox",  # code shared by plugins
    "plugin",  # the plugin interface
    "registry",  # name -> plugin
    "backends",  # one rasterizer interface, three implementations
    "fisher",  # Fisher information and scores
    "warp",  # warping by depth, soft z-buffer
    "initialize",  # initial Gaussians
    "depth",  # depth of the training views
    "scenes",  # photos, cameras, points, splits
    "records",  # files of a run
    "metrics",  # PSNR, SSIM, FLIP, LPIPS
    "kernels",  # rasterization, forward and backward
    "geometry",  # projection, rotations
    "shapes",  # checks of values
    "types",  # shared types
    "options",  # options of the trainer
    "compute",  # compilation, threads, random streams
    "files",  # reading and writing safely
    "errors",  # one-line errors
)
MOST_ROOMS, MOST_FILES = 18, 8  # folders, and files that lie in none

PLUGIN_MAY_IMPORT = {
    f"framework.{name}"
    for name in (
        *("plugin", "types", "shapes", "geometry", "errors", "registry"),
        *("toolbox", "fisher", "warp", "kernels.losses", "scenes", "depth", "initialize"),
        *("compute.portable", "compute.rng", "compute.tensors"),
    )
}
REPORT_MUST_NOT_IMPORT = {
    *("torch", "numba", "plugins"),
    *(f"framework.{name}" for name in ("train", "run", "kernels", "types", "records.ply")),
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
    for statement in parsed(path).body:
        if isinstance(statement, ast.Import | ast.ImportFrom):
            yield from imported(statement)


def loaded(path: Path, seen: set[Path]) -> Iterator[str]:
    """All modules that importing `path` loads, through the project's own."""
    seen.add(path)
    for module in at_import_time(path):
        yield module
        ours = ROOT / Path(*module.split("."))
        for file in (ours.with_suffix(".py"), ours / "__init__.py"):
            if file.is_file() and file not in seen:
                yield from loaded(file, seen)


def module_of(path: Path) -> str:
    """The full name of the module in a file."""
    names = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(names[:-1] if names[-1] == "__init__" else names)


MODULES = {module_of(path): path for path in [*FRAMEWORK, *PLUGINS]}


def taken(path: Path) -> Iterator[tuple[str, str | None]]:
    """(module of ours, name taken from it or None for all of it) of every import statement of a
    file: also in functions and under TYPE_CHECKING."""
    for statement in ast.walk(parsed(path)):
        if isinstance(statement, ast.Import):
            yield from ((a.name, None) for a in statement.names if a.name in MODULES)
        elif isinstance(statement, ast.ImportFrom) and statement.module in MODULES:
            for alias in statement.names:
                whole = f"{statement.module}.{alias.name}"
                yield (whole, None) if whole in MODULES else (statement.module, alias.name)


def room(module: str) -> str:
    """The room of a module of the framework; "" for the package itself."""
    return module.split(".")[1] if "." in module else ""


def climbs(path: Path, module: str = "") -> list[str]:
    """The imports of a file, or of a text in place of `module`, that go up or to a room that
    the list lacks."""
    ours, actual = room(module or module_of(path)), []
    for other_module, _ in taken(path):
        other = room(other_module)
        if not other or other == ours or not covers("framework", other_module):
            continue
        if other not in ROOMS or ROOMS.index(other) < ROOMS.index(ours):
            actual.append(f"{ours} imports {other_module} of {other}, which is above it")
    return actual


def past_the_door(path: Path) -> list[str]:
    """What a file takes from other rooms that their doors do not hand out."""
    ours, actual = module_of(path), []
    for module, name in taken(path):
        if not covers("framework", module) or (
            covers("framework", ours) and room(ours) == room(module)
        ):
            continue
        inside = module.split(".")[2:]
        door = MODULES.get(f"framework.{room(module)}")
        wanted = inside[0] if inside else name
        if door is None or door.name != "__init__.py" or room(module) == "" or wanted is None:
            continue
        names = handed_out(door)
        if names is not None and wanted not in names:
            actual.append(f"{ours} takes {wanted} from {room(module)}, whose __all__ lacks it")
    return actual


def handed_out(door: Path) -> list[str] | None:
    """The names in `__all__` of a room's `__init__.py`; None for all, as of a room without it."""
    for statement in parsed(door).body:
        if isinstance(statement, ast.Assign) and ast.unparse(statement.targets[0]) == "__all__":
            return [str(name) for name in ast.literal_eval(statement.value)]
    return None


def covers(rule: str, module: str) -> bool:
    return module == rule or module.startswith(f"{rule}.")


def everything(path: Path) -> list[str]:
    return list(imported(parsed(path)))


def name_of(path: Path) -> str:
    return str(path.relative_to(ROOT))


def test_the_framework_imports_and_names_no_plugin() -> None:
    packages = {*registry.GROUPS.values(), *registry.PARTS.values()}
    for path in FRAMEWORK:
        texts = {node.value for node in ast.walk(parsed(path)) if isinstance(node, ast.Constant)}
        named = {text for text in texts if isinstance(text, str) and text.startswith("plugins.")}
        modules = {module for module in everything(path) if covers("plugins", module)}
        assert not (named | modules) - packages, name_of(path)


def test_a_plugin_imports_only_its_contracts() -> None:
    for path in PLUGINS:
        ours = [module for module in everything(path) if covers("framework", module)]
        actual = [m for m in ours if not any(covers(rule, m) for rule in PLUGIN_MAY_IMPORT)]
        actual += [module for module in everything(path) if covers("plugins", module)]
        assert not actual, name_of(path)


def test_a_plugin_is_light_to_import() -> None:
    for path in PLUGINS:
        heavy = {module.partition(".")[0] for module in loaded(path, set())} & HEAVY
        assert not heavy, name_of(path)


def test_the_report_reads_records_only() -> None:
    for path in REPORT:
        modules = everything(path)
        actual = [m for m in modules if any(covers(rule, m) for rule in REPORT_MUST_NOT_IMPORT)]
        assert not actual, name_of(path)


def test_imports_go_down_only() -> None:
    assert not [line for path in FRAMEWORK for line in climbs(path)]


@pytest.mark.parametrize(
    "text",
    [
        "def late():\n    from framework.train.trainer import Trainer\n",
        "if TYPE_CHECKING:\n    import framework.report\n",
    ],
)
def test_an_import_that_climbs_is_found_wherever_it_stands(text: str, tmp_path: Path) -> None:
    file = tmp_path / "climbing.py"
    file.write_text(text)
    (actual,) = climbs(file, "framework.files.climbing")
    assert actual.startswith("files imports framework.") and actual.endswith("which is above it")


def test_rooms_are_entered_by_their_doors() -> None:
    assert not [line for path in [*FRAMEWORK, *PLUGINS] for line in past_the_door(path)]


def test_no_import_goes_in_a_circle() -> None:
    edges = {name: {m for m, _ in taken(path)} - {name} for name, path in MODULES.items()}
    TopologicalSorter(edges).prepare()  # raises CycleError, which names the circle


def test_the_house_is_not_a_heap() -> None:
    inside = [p for p in (ROOT / "framework").iterdir() if p.name != "__pycache__"]
    rooms, files = [p for p in inside if p.is_dir()], [p for p in inside if p.is_file()]
    assert len(rooms) <= MOST_ROOMS and len(files) <= MOST_FILES
    assert {p.stem for p in inside} - {"__init__"} == set(ROOMS)


def test_a_room_says_what_it_is_for() -> None:
    for door in (ROOT / "framework").rglob("__init__.py"):
        assert door.parent == ROOT / "framework" or ast.get_docstring(parsed(door)), name_of(door)
