"""The documents are correct: their commands run."""

import re
from pathlib import Path

import pytest

from framework.command.cli import main
from framework.command.config.schema import ROOT, SWEEPS_DIR
from framework.command.subcommands import SUBCOMMANDS
from tests.cli.conftest import FakeRuns, last_values

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


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_of_the_documents_runs(
    runs: FakeRuns, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    Path("DIR").mkdir()
    # seeds all start alike, and the test of the command line has three of them
    command = re.sub(r"scene\.path=\S+", "scene.path=DIR", command)
    command = command.replace("NAME", "uar")  # in place of the reader's plugin
    words = [re.sub(r"^seed=.*,.*", "seed=0", word) for word in command.split()]
    inputs = {word.split("=")[0] for word in words}
    for word in list(words):
        if word.startswith("sweep="):
            last = last_values(SWEEPS_DIR / f"{word.removeprefix('sweep=')}.yaml")
            words += [f"{key}={value}" for key, value in last.items() if key not in inputs]
    assert main(words) == 0, capsys.readouterr().err
