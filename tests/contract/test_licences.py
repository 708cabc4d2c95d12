"""Nothing that the project depends on may be copyleft, as the project itself is under MIT."""

import re
import tomllib
from importlib.metadata import PackageNotFoundError, distribution, metadata

import pytest

from framework.command.config.schema import ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
# the GPL family; the MPL's copyleft ends at its own files, which tests (hypothesis) do not change
COPYLEFT = re.compile(r"\b[AL]?GPL|GNU |Affero|EUPL|CeCILL|Sleepycat|SSPL|\bOSL", re.IGNORECASE)
GROUPS = [PROJECT["dependencies"], *PROJECT["optional-dependencies"].values()]
NAMES = {re.split(r"[\[<>=~!; ]", line)[0] for group in GROUPS for line in group}


def licence(name: str) -> str:
    """What an installed package says its licence is."""
    message = metadata(name)
    classifiers = [c for c in message.get_all("Classifier") or [] if c.startswith("License")]
    lines = (message.get("License") or "").strip().splitlines()[:1]  # some put the whole text there
    actual = [*filter(None, [message.get("License-Expression")]), *classifiers, *lines]
    return "; ".join(actual or _first_line_of_file(name))


def _first_line_of_file(name: str) -> list[str]:
    """Some only bring the text."""
    files = [f for f in distribution(name).files or [] if f.name.startswith("LICENSE")]
    return [file.read_text().strip().splitlines()[0].strip() for file in files[:1]]


@pytest.mark.parametrize("name", sorted(NAMES - {PROJECT["name"]}))
def test_no_dependency_is_copyleft(name: str) -> None:
    try:
        message = licence(name)
    except PackageNotFoundError:
        pytest.skip(f"{name}: not installed here, an extra")
    assert message, f"{name}: no licence in its metadata"
    # "or" leaves the choice, as of packages under BSD or GPL
    assert not all(COPYLEFT.search(part) for part in re.split(r"\s+OR\s+|; ", message)), message


def test_the_project_states_its_own() -> None:
    assert PROJECT["license"] == "MIT"
    assert (ROOT / "LICENSE").read_text(encoding="utf-8").startswith("MIT License")
    assert "MIT" in (ROOT / "README.md").read_text(encoding="utf-8")
