"""docs/architecture.md is correct: its files and names exist, its packages are complete. The
files and names in CONTRIBUTING.md and README.md exist, too."""

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

from framework.command.config.schema import ROOT
from tests.contract.test_imports import ROOMS

PAGE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
FILE = r"[\w./]+\.(?:py|yaml|md|png|svg)"


OURS = ("framework/", "tests/", "benchmarks/", "docs/", "conf/", "sweeps/")


def named(page: str) -> list[tuple[str, str]]:
    """(path, name or "") of `path`, `path:name` and `:name`, which is of the path before it."""
    actual, last = [], ""
    for path, name in re.findall(rf"`({FILE})?(?::([\w.]+))?`", page):
        last = path or last
        actual.append((last, name))
    return actual


def holds(file: Path, name: str) -> bool:
    """Whether a Python file defines a dotted name: of a module, a class or a function."""
    body: list[ast.stmt] = ast.parse(file.read_text(encoding="utf-8")).body
    for part in name.split("."):
        inside = next((node for node in body if part in names_of(node)), None)
        if inside is None:
            return False
        body = getattr(inside, "body", [])
    return True


def names_of(node: ast.stmt) -> list[str]:
    """What a statement defines."""
    if isinstance(node, ast.FunctionDef | ast.ClassDef):
        return [node.name]
    targets = node.targets if isinstance(node, ast.Assign) else []
    targets = [node.target] if isinstance(node, ast.AnnAssign) else targets
    return [target.id for target in targets if isinstance(target, ast.Name)]


def test_what_the_page_names_exists() -> None:
    for path, name in dict.fromkeys(named(PAGE)):
        actual = path == "__init__.py" or (ROOT / path).is_file()  # the first is that of any room
        assert actual, f"docs/architecture.md: no file {path}"
        assert not name or holds(ROOT / path, name), f"docs/architecture.md: {path} has no {name}"


OTHERS = [p.relative_to(ROOT).as_posix() for p in sorted((ROOT / "docs").rglob("*.md"))]


def test_what_other_pages_name_exists() -> None:
    for page in ["CONTRIBUTING.md", "README.md", *OTHERS]:
        text = (ROOT / page).read_text(encoding="utf-8")
        gone = [path for path in re.findall(r"`([\w./]+/)`", text) if not (ROOT / path).is_dir()]
        for path, name in named(text):
            if path.startswith(OURS) and not (ROOT / path).is_file():
                gone.append(path)
            elif path.startswith(OURS) and name and not holds(ROOT / path, name):
                gone.append(f"{path}:{name}")
        assert not [path for path in gone if path.startswith(OURS)], page


def test_the_table_has_the_rooms_in_their_order() -> None:
    rows = re.findall(r"^\| `(\w+)/?` \|", PAGE, re.MULTILINE)
    assert [row for row in rows if row != "plugins"] == list(ROOMS)


@pytest.mark.slow
def test_the_picture_has_every_room_and_the_same_bytes_twice(tmp_path: Path) -> None:
    drawn = []
    for name in ("a", "b"):
        folder = tmp_path / name
        folder.mkdir()
        subprocess.run([sys.executable, ROOT / "docs" / "rooms.py", folder], check=True)
        drawn.append([(folder / f"rooms.{kind}").read_bytes() for kind in ("png", "svg")])
    assert drawn[0] == drawn[1]
    texts = re.findall(r">(\w+)</text>", drawn[0][1].decode())
    assert set(ROOMS) <= set(texts)
