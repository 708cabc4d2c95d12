"""The program's name, version, subcommands and the user's own plugins."""

import io
import os
import subprocess
import sys
from pathlib import Path

import pytest

import framework
from framework.command.cli import main
from framework.command.config.schema import ROOT
from framework.command.entry import command

OWN = """
from dataclasses import dataclass
from framework.plugin import Regularizer, register

@register("reg", "of_mine")
@dataclass(frozen=True)
class OfMine(Regularizer):
    strength: float = 0.5  # how much

    def loss(self, ctx, state, view, render):
        return None
"""


def run(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """The command line in a separate process and an empty folder."""
    return subprocess.run(
        [sys.executable, str(ROOT / "run.py"), *words],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
    )


def test_the_version_is_ours(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"fishersplat {framework.__version__}\n"


def test_own_plugins_are_found_when_the_command_line_asks(tmp_path: Path) -> None:
    (tmp_path / "mine" / "regularize").mkdir(parents=True)
    (tmp_path / "mine" / "regularize" / "of_mine.py").write_text(OWN)
    asked = run(tmp_path, "--plugins", "mine", "reg=of_mine", "--cfg", "job")
    assert asked.returncode == 0 and "strength: 0.5" in asked.stdout, asked.stderr
    unasked = run(tmp_path, "reg=of_mine", "--cfg", "job")
    assert unasked.returncode != 0 and "of_mine" in unasked.stderr
    assert "Traceback" not in unasked.stderr


def test_a_terminal_that_lacks_our_letters_gets_others(monkeypatch: pytest.MonkeyPatch) -> None:
    written = io.BytesIO()
    for name in ("stdout", "stderr"):
        monkeypatch.setattr(sys, name, io.TextIOWrapper(written, encoding="ascii", errors="strict"))
    with pytest.raises(SystemExit):
        command(["--version"], "fishersplat")
    print("22.3 dB · 4 s", flush=True)  # as progress has it
    assert written.getvalue().endswith(b"22.3 dB \\xb7 4 s\n")


def test_ctrl_c_while_modules_are_imported_is_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class Interrupting:
        def find_spec(self, name: str, *_: object) -> None:
            if name == "framework.files.program":
                raise KeyboardInterrupt

    monkeypatch.delitem(sys.modules, "framework.files.program")
    monkeypatch.setattr(sys, "meta_path", [Interrupting(), *sys.meta_path])
    with pytest.raises(SystemExit) as ended:
        command(["--version"], "fishersplat")
    assert ended.value.code == 130
    assert capsys.readouterr().err == "error: interrupted\n"
