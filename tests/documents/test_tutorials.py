"""Every block of the tutorials runs, in their order, as a reader would type it, only smaller."""

import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from framework.command.cli import main
from framework.command.config.schema import ROOT
from framework.files.program import take_flag
from tests.documents.pages import Block, blocks, quick, tutorials, words_of
from tests.documents.registered import as_before

SHOWN = {
    "text",
    "toml",
    "json",
    "bibtex",
}  # not typed by the reader: output, and files of other projects


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("page", tutorials(), ids=lambda page: page.stem)
def test_its_blocks_run(page: Path, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    try:
        with as_before():
            namespace: dict[str, Any] = {}  # of the page's Python blocks
            for block in blocks(page):
                obey(block, capsys, namespace)
            if page.stem == "own-photos":  # what the README speaks of is there now
                for block in blocks(ROOT / "README.md"):
                    obey(_filled(block), capsys)
    finally:
        take_flag([])  # later tests have no plugins of a reader's


def _filled(block: Block) -> Block:
    """A block of the README with folders for its names; make prints its commands, and the viewer
    writes its page instead of waiting."""
    run = next(Path("reports/mine/runs").iterdir())
    text = block.text.replace("path=DIR", "path=photos").replace("make ", f"make -nC {ROOT} ")
    return replace(block, text=text.replace("view RUN", f"view --static -- {run}"))


def obey(
    block: Block, capsys: pytest.CaptureFixture[str], namespace: dict[str, Any] | None = None
) -> None:
    """Write the file, run the commands or execute the Python code of a block."""
    if block.title:
        Path(block.title).parent.mkdir(parents=True, exist_ok=True)
        Path(block.title).write_text(block.text, encoding="utf-8")
        return
    if block.language in SHOWN:
        return
    if block.language == "python":
        exec(block.text, namespace)
        return
    assert block.language == "bash", f"a block of {block.language}: give it a title or make it text"
    for line in block.lines():
        words = words_of(line)
        if words is None:
            subprocess.run(["bash", "-euc", line], check=True, timeout=60)
            continue
        assert main(quick(words)) == block.exit_code, f"{line}\n{capsys.readouterr().err}"
