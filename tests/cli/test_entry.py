"""The program's name, version, subcommands and the user's own plugins."""

from __future__ import annotations

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
from framework.files.paths import OWN_VARIABLE, own_plugins
from framework.records.provenance import provenance

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


def test_a_python_without_our_packages_is_told_in_a_line(tmp_path: Path) -> None:
    message = subprocess.run(
        [sys.executable, "-S", str(ROOT / "run.py"), "seed=1"],
        cwd=tmp_path,
        env={k: v for k, v in os.environ.items() if k != "PYTHONPATH"},
        capture_output=True,
        text=True,
    )
    assert message.returncode == 2 and message.stdout == ""
    assert (
        message.stderr.startswith(f"error: {sys.executable} ") and message.stderr.count("\n") == 1
    )
    assert "lacks torch, numba, hydra" in message.stderr and "pip install -e ." in message.stderr


def test_the_version_is_ours(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"fishersplat {framework.__version__}\n"


def test_a_terminal_that_lacks_our_letters_gets_others(monkeypatch: pytest.MonkeyPatch) -> None:
    written = io.BytesIO()
    for name in ("stdout", "stderr"):
        monkeypatch.setattr(sys, name, io.TextIOWrapper(written, encoding="ascii", errors="strict"))
    with pytest.raises(SystemExit):
        command(["--version"])
    print("22.3 dB · 4 s", flush=True)  # as progress has it
    assert written.getvalue().endswith(b"22.3 dB \\xb7 4 s\n")


def test_an_unknown_subcommand_is_told_with_the_nearest(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["repot", "DIR"]) == 2
    message = capsys.readouterr().err
    assert "got 'repot'; did you mean 'report'?" in message and message.count("\n") == 1


def test_own_plugins_are_found_when_the_command_line_asks(tmp_path: Path) -> None:
    (tmp_path / "mine" / "regularize").mkdir(parents=True)
    (tmp_path / "mine" / "regularize" / "of_mine.py").write_text(OWN)
    asked = run(tmp_path, "--plugins", "mine", "reg=of_mine", "--cfg", "job")
    assert asked.returncode == 0 and "strength: 0.5" in asked.stdout, asked.stderr
    unasked = run(tmp_path, "reg=of_mine", "--cfg", "job")
    assert unasked.returncode != 0 and "of_mine" in unasked.stderr
    assert "Traceback" not in unasked.stderr


def test_helpers_count_as_code_and_are_no_plugins(tmp_path: Path) -> None:
    (tmp_path / "of_mine.py").write_text(OWN)
    (tmp_path / "_helper.py").write_text("raise ValueError('imported')")
    actual = run(tmp_path, "--plugins", ".", "reg=of_mine", "--cfg", "job")
    assert actual.returncode == 0, actual.stderr
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(OWN_VARIABLE, str(tmp_path))
        assert [place for place, _ in own_plugins()] == ["_helper.py", "of_mine.py"]
        assert provenance()["own_plugins"] == ["_helper.py", "of_mine.py"]
    assert "own_plugins" not in provenance()


@pytest.mark.parametrize("words", [["--plugins"], ["--plugins", "none"], ["--plugins=a=b"]])
def test_a_folder_of_plugins_that_is_none(
    words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*words, "seed=1"]) == 2
    assert "--plugins: expected a folder with plugins" in capsys.readouterr().err


def test_a_broken_own_plugin_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "broken.py").write_text("1 / 0\n")
    done = run(tmp_path, "--plugins", ".", "--cfg", "job")
    assert done.returncode == 2 and "broken.py" in done.stderr
    assert done.stderr.count("\n") == 1, done.stderr


def test_the_shell_completes_groups_and_choices(tmp_path: Path) -> None:
    typed = "fishersplat +reg=u"
    done = subprocess.run(
        [sys.executable, str(ROOT / "run.py"), "-sc", "query=bash"],
        cwd=tmp_path,
        env={
            **os.environ,
            "PYTHONPATH": str(ROOT),
            "COMP_LINE": typed,
            "COMP_POINT": str(len(typed)),
        },
        capture_output=True,
        text=True,
    )
    assert done.stdout.split() == ["+reg=uar", "+reg=uar_hard", "+reg=uniform"], done.stderr
