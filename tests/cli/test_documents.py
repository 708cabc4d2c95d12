"""The documents are correct: their commands run, their tables are complete."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest
from omegaconf import OmegaConf

from framework.command.cli import main
from framework.command.config.schema import CONF_DIR, OBJECT_GROUPS, ROOT, SWEEPS_DIR, choices
from framework.command.subcommands import SUBCOMMANDS
from tests.cli.conftest import FakeRuns, composed

README = (ROOT / "README.md").read_text(encoding="utf-8")
PAGES = [
    ROOT / "CONTRIBUTING.md",
    # pages on launchers and the like have commands that need an extra
    *(ROOT / "docs" / f"{n}.md" for n in ("benchmarks", "choices", "layouts", "runs", "studies")),
]  # those of the tutorials run, see tests/documents
TYPED = re.compile(r"(?:^|`| {4})(?:python run\.py|fishersplat) +([^\s`#][^\n`#]*)", re.MULTILINE)
COMMANDS = sorted(
    {
        match.group(1).strip()
        for page in PAGES
        for match in TYPED.finditer(page.read_text(encoding="utf-8"))
        if match.group(1).split()[0] not in SUBCOMMANDS
    }
)
CHOICES, STUDIES = (
    (ROOT / "docs" / name).read_text(encoding="utf-8") for name in ("choices.md", "studies.md")
)
DEMO = "python run.py sweep=first"


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_of_the_documents_runs(
    runs: FakeRuns, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    Path("DIR").mkdir()
    # a sweep's seeds all start alike, and the test of the command line has three of them
    command = re.sub(r"scene\.path=\S+", "scene.path=DIR", command)
    command = command.replace("NAME", "uar")  # in place of the reader's plugin
    words = [re.sub(r"^seed=.*,.*", "seed=0,1", word) for word in command.split()]
    inputs = {word.split("=")[0] for word in words}
    for word in list(words):
        if word.startswith("sweep="):
            last = _one_run(word.removeprefix("sweep="))
            words += [value for value in last if value.split("=")[0] not in inputs]
    assert main(words) == 0, capsys.readouterr().err


def _one_run(sweep: str) -> list[str]:
    """The last value of everything a sweep varies: one start instead of a hundred."""
    params = OmegaConf.load(SWEEPS_DIR / f"{sweep}.yaml").hydra.sweeper.params
    return [f"{name}={str(values).split(',')[-1]}" for name, values in params.items()]


@pytest.mark.parametrize("sweep", sorted(path.stem for path in SWEEPS_DIR.glob("*.yaml")))
def test_every_value_of_a_sweep_is_accepted(sweep: str) -> None:
    params = OmegaConf.load(SWEEPS_DIR / f"{sweep}.yaml").hydra.sweeper.params
    lists = {name: str(v).split(",") for name, v in params.items() if name != "seed"}
    scene = [] if sweep not in ("tables", "draws") else ["scene=llff", "scene.path=DIR"]
    for i in range(max(map(len, lists.values()))):
        composed(*scene, *(f"{name}={values[i % len(values)]}" for name, values in lists.items()))


def test_the_readme_is_short_and_has_what_to_type() -> None:
    assert len(README.splitlines()) <= 120
    assert "make demo" in README and "make test" in README
    assert "scene=photos scene.path=DIR" in README and "fishersplat view RUN" in README


@pytest.mark.parametrize("group", OBJECT_GROUPS)
def test_the_page_of_choices_lists_every_choice(group: str) -> None:
    row = next(line for line in CHOICES.splitlines() if line.startswith(f"| `{group}`"))
    variants = [path.stem for path in CONF_DIR.glob(f"{group}/*.yaml")]
    missing = [name for name in choices(group) + variants if f"`{name}`" not in row]
    assert not missing, f"docs/choices.md: the row `{group}` lacks {', '.join(missing)}"


def test_the_page_of_studies_names_every_study() -> None:
    assert all(f"sweep={path.stem}" in STUDIES for path in SWEEPS_DIR.glob("*.yaml"))


@pytest.mark.skipif(shutil.which("make") is None, reason="no make on this machine")
def test_make_demo_runs_the_exact_command() -> None:
    done = subprocess.run(
        ["make", "-n", "demo"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert DEMO in done.stdout
