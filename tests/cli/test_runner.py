"""A command from its arguments to the exit code, with a stand-in for the training."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from framework.command.config.schema import ROOT

# a command whose run and report are those of the script, in place of the framework's
SCRIPT = """
import os, signal, sys, time, types
from pathlib import Path
from framework.command import entry

signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs ignore it

run, report = types.ModuleType("framework.run.experiment"), types.ModuleType("framework.report")
{body}
run.run_experiment = run_experiment
report.build_report = build_report
sys.modules |= {{"framework.run.experiment": run, "framework.report": report}}
entry.command(sys.argv[1:], "python run.py")
"""
SLOW = """
def run_experiment(config, run_dir, progress, overrides):
    try:
        print("busy", flush=True)
        time.sleep(50)
    finally:
        print("tidied", flush=True)
build_report = None
"""


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FISHERSPLAT_CACHE", str(tmp_path / "cache"))


def _started(body: str, folder: Path) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", SCRIPT.format(body=body)],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def test_ctrl_c_ends_run_and_command(tmp_path: Path) -> None:
    process = _started(SLOW, tmp_path)
    assert process.stdout is not None
    while "busy" not in process.stdout.readline():
        assert process.poll() is None
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=30)
    assert process.returncode == 130
    assert "tidied" in out
    assert err.startswith("error: interrupted; results are kept") and err.count("\n") == 1


def test_a_run_goes_on_without_a_reader(tmp_path: Path) -> None:
    """As after `| head -1`: the output is discarded, and the rest is unchanged."""
    body = """
def run_experiment(config, run_dir, progress, overrides):
    progress.done("begun")
    while not os.path.exists("unread"):
        time.sleep(0.01)
    for _ in range(3):
        progress.done("more")
def build_report(folder):
    open("built", "w").close()
    return folder / "report.md"
"""
    process = _started(body, tmp_path)
    assert process.stdout is not None and process.stderr is not None
    assert "begun" in process.stdout.readline()
    process.stdout.close()
    (tmp_path / "unread").touch()
    assert process.stderr.read() == ""
    assert process.wait(60) == 0 and (tmp_path / "built").exists()
