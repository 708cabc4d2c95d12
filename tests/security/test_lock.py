"""The lock file fits pyproject.toml, and nothing has a flaw that is known and matters here."""

import importlib.metadata
import re
import tomllib

import pytest
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet
from packaging.utils import canonicalize_name

from framework.command.config.schema import ROOT

# versions with a flaw that a bad file could use, and its name
FLAWED = {
    "pillow": (SpecifierSet("<10.3"), "CVE-2024-28219, CVE-2023-50447"),
    "torch": (SpecifierSet("<2.6"), "CVE-2025-32434: weights_only runs code"),
    "opencv-contrib-python-headless": (SpecifierSet("<4.8.1.78"), "CVE-2023-4863: WebP"),
    "joblib": (SpecifierSet("<1.2"), "CVE-2022-21797"),
}
OF_THE_MACHINE = {"torch"}


def _locked() -> dict[str, str]:
    """Name -> version of every entry; each has a hash."""
    text = (ROOT / "requirements-ci.txt").read_text(encoding="utf-8")
    entries = [e for e in re.split(r"\n(?=[A-Za-z0-9])", text) if not e.startswith("#")]
    actual = {}
    for entry in entries:
        match = re.match(r"([\w.-]+)==([\w.]+) \\\n", entry)
        assert match and re.search(r"--hash=sha256:[0-9a-f]{64}", entry), entry[:80]
        actual[canonicalize_name(match[1])] = match[2]
    return actual


def _wanted() -> list[Requirement]:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"]
    listed = [*project["dependencies"], *extras["dev"], *extras["oracles"]]
    return [r for r in map(Requirement, listed) if r.name != project["name"]]


def test_the_lock_holds_what_the_project_wants() -> None:
    locked = _locked()
    for requirement in _wanted():
        name = canonicalize_name(requirement.name)
        if name not in OF_THE_MACHINE:
            assert name in locked, f"{name} is missing; run `make lock`"
            assert requirement.specifier.contains(locked[name]), f"{name}; run `make lock`"
    assert not OF_THE_MACHINE & locked.keys()


@pytest.mark.parametrize("name", sorted(FLAWED))
def test_no_version_has_a_known_flaw(name: str) -> None:
    bad, flaw = FLAWED[name]
    versions = {_locked().get(name), importlib.metadata.version(name)} - {None}
    assert not [v for v in versions if bad.contains(str(v), prereleases=True)], flaw
    least = [
        spec.version
        for r in _wanted()
        if r.name == name
        for spec in r.specifier
        if spec.operator == ">="
    ]
    assert not [v for v in least if bad.contains(v)], f"pyproject.toml allows {name} with {flaw}"
