"""A configuration is data: whatever a stranger's file or command line asks for, no code of theirs
runs, the environment stays private, and nothing grows beyond the limits.

Every way of running code here would make the folder `canary`.
"""

from __future__ import annotations

import pickle
from pathlib import Path

import pytest

from framework.command.cli import main
from framework.command.config import trust
from framework.command.config.schema import CONF_DIR, SWEEPS_DIR
from framework.errors import UserError
from framework.files import limits
from tests.cli.conftest import FakeRuns, runs

__all__ = ["runs"]  # the fixture

CALL = "{_target_: os.mkdir, path: canary}"
HANDLER = "{version: 1, handlers: {x: {'()': os.mkdir, path: canary}}}"
LINES = {
    "+hydra.callbacks.x._target_=os.mkdir +hydra.callbacks.x.path=canary": "hydra.callbacks",
    "++hydra.callbacks.study._target_=os.mkdir": "hydra.callbacks",
    "hydra.launcher._target_=os.mkdir +hydra.launcher.path=canary": "hydra.launcher",
    "hydra/launcher=joblib hydra.launcher.pre_dispatch=1": "hydra.launcher.pre_dispatch",
    "hydra/launcher=joblib hydra.launcher.n_jobs=100000": "hydra.launcher.n_jobs",
    "hydra.sweeper._target_=os.mkdir": "hydra.sweeper",
    "+hydra.job_logging.handlers={x:{'()':os.mkdir,path:canary}}": "hydra.job_logging",
    "+hydra.hydra_logging.handlers={x:{'()':os.mkdir,path:canary}}": "hydra.hydra_logging",
    "hydra/job_logging=default": "hydra.job_logging",
    "+hydra.job.env_set.PYTHONPATH=/tmp": "hydra.job",
    "hydra.job.env_copy=[HOME]": "hydra.job",
    "hydra.output_subdir=../..": "hydra.output_subdir",
    "hydra.searchpath=[pkg://antigravity]": "hydra.searchpath: expected folders",
    "++hydra.searchpath=[pkg://antigravity]": "hydra.searchpath: expected folders",
    "--experimental-rerun job.pickle": "--experimental-rerun: expected no such flag",
    "--config-dir own": "--config-dir: expected no such flag",
    "--config-path own": "--config-path: expected no such flag",
    "--config-name other": "--config-name: expected no such flag",
    "scene=${oc.env:SECRET}": "may not read",
    "preset=${oc.env:SECRET}": "may not read",
    "method=${scene}": "method: expected a choice, got 'method=${scene}'; write its name",
    "study=${oc.env:SECRET}": "may not read",
    "+scene._target_=os.mkdir": "scene._target_: unknown option",
    "+reg.weight._target_=os.mkdir": "reg.weight",
    "+trainer._target_=os.mkdir": "trainer._target_: unknown option",
    "seed=range(1000000000) -m": "at most 100,000 runs, got 1,000,000,000",
    "seed=range(400) threads=range(400) -m": "at most 100,000 runs, got 160,000",
    "seed=range(0,5,0) -m": "expected a step other than 0",
}
FILES = {
    f"hydra:\n  callbacks:\n    x: {CALL}\n": "hydra.callbacks",
    f"hydra:\n  launcher: {CALL}\n": "hydra.launcher",
    f"hydra:\n  sweeper: {CALL}\n": "hydra.sweeper",
    f"hydra:\n  job_logging: {HANDLER}\n": "hydra.job_logging",
    f"hydra:\n  hydra_logging: {HANDLER}\n": "hydra.hydra_logging",
    "hydra:\n  job:\n    env_set:\n      LD_PRELOAD: evil.so\n": "hydra.job",
    "hydra:\n  run:\n    dir: /tmp/elsewhere\n": "hydra.run.dir: expected it on the command line",
    "hydra:\n  sweep:\n    dir: /tmp/elsewhere\n": "hydra.sweep.dir: expected it on the command",
    "hydra:\n  sweeper:\n    params:\n      hydra.searchpath: '[pkg://antigravity]'\n": "params",
    "hydra:\n  sweeper:\n    params:\n      +hydra.job.env_set.A: 1\n": "params",
    "hydra:\n  sweeper:\n    params:\n      seed: range(1000000000)\n": "at most 100,000 runs",
    "study: ../../elsewhere\n": "study: expected a folder name",
    "study: ${oc.env:SECRET}\n": "may not read",
    "a: &a [x, x]\nb: &b [*a, *a]\nc: [*b, *b]\n": "expected no YAML aliases, got *a in line 3",
    f"a: {'[' * 40}{']' * 40}\n": "at most 32 nested levels",
    "a: [1\n": "expected YAML",
    "a: \x00\n": "expected YAML",
    f"a: {'x' * 300_000}\n": "at most 262,144 bytes",
}


def refused(capsys: pytest.CaptureFixture[str], runs: FakeRuns, code: int) -> str:
    """The one line with which the command ended, without having run anything."""
    told = capsys.readouterr().err.splitlines()
    assert code == 2 and len(told) == 1, told
    assert not runs.seen
    assert not Path("canary").exists()
    assert not Path("reports").exists()
    assert len(told[0]) < 500
    assert "hidden" not in told[0]
    return told[0]


@pytest.fixture(autouse=True)
def bait(runs: FakeRuns, monkeypatch: pytest.MonkeyPatch) -> None:
    """A secret in the environment, a pickle that makes the canary, another configuration."""

    class Mkdir:
        def __reduce__(self) -> tuple[object, tuple[str]]:
            return Path.mkdir, (Path("canary"),)

    monkeypatch.setenv("SECRET", "hidden")
    Path("job.pickle").write_bytes(pickle.dumps(Mkdir()))
    Path("own/experiment").mkdir(parents=True)


@pytest.mark.parametrize("line", LINES)
def test_a_command_line_runs_no_code(
    runs: FakeRuns, capsys: pytest.CaptureFixture[str], line: str
) -> None:
    told = refused(capsys, runs, main(line.split()))
    assert LINES[line] in told


@pytest.mark.parametrize("flag", ["--help", "--cfg=job", "--info", "--hydra-help"])
def test_flags_that_only_inform_run_no_code_either(
    runs: FakeRuns, capsys: pytest.CaptureFixture[str], flag: str
) -> None:
    line = ["+hydra.callbacks.x._target_=os.mkdir", "+hydra.callbacks.x.path=canary"]
    assert "hydra.callbacks" in refused(capsys, runs, main([flag, *line]))
    assert "pkg://" in refused(capsys, runs, main([flag, "hydra.searchpath=[pkg://this]"]))


@pytest.mark.parametrize("text", FILES)
def test_an_experiment_file_runs_no_code(
    runs: FakeRuns, capsys: pytest.CaptureFixture[str], text: str
) -> None:
    Path("own/experiment/evil.yaml").write_text(f"# @package _global_\n{text}", encoding="utf-8")
    search = f"hydra.searchpath=[file://{Path('own').resolve()}]"
    assert FILES[text] in refused(capsys, runs, main([search, "experiment=evil"]))


def test_an_experiment_among_swept_ones_runs_no_code(
    runs: FakeRuns, capsys: pytest.CaptureFixture[str]
) -> None:
    text = f"# @package _global_\nhydra:\n  job_logging: {HANDLER}\n"
    Path("own/experiment/evil.yaml").write_text(text, encoding="utf-8")
    search = f"hydra.searchpath=[file://{Path('own').resolve()}]"
    code = main([search, "experiment=smoke,evil", "-m"])
    assert "hydra.job_logging" in refused(capsys, runs, code)


def test_a_launcher_of_the_same_name_is_not_ours(
    runs: FakeRuns, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("own/hydra/launcher").mkdir(parents=True)
    Path("own/hydra/launcher/mine.yaml").write_text("_target_: os.mkdir\npath: canary\n")
    search = f"hydra.searchpath=[file://{Path('own').resolve()}]"
    code = main([search, "hydra/launcher=mine", "-m"])
    assert "hydra.launcher: expected" in refused(capsys, runs, code)


@pytest.mark.parametrize(
    "line",
    [
        "hydra.run.dir=here",
        "hydra.sweep.dir=there seed=0,1 -m",
        "hydra/launcher=basic -m",
        "hydra.verbose=false",
        "seed=range(3) reg=none,uar -m",
        "study=${seed}",
    ],
)
def test_honest_uses_stay(runs: FakeRuns, line: str) -> None:
    assert main(line.split()) == 0
    assert runs.seen


def test_the_joblib_launcher_stays(capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("hydra_plugins.hydra_joblib_launcher", reason="no joblib launcher here")
    assert main(["hydra/launcher=joblib", "hydra.launcher.n_jobs=2", "--cfg", "hydra"]) == 0
    assert "n_jobs: 2" in capsys.readouterr().out


def test_our_own_configurations_are_within_the_limits() -> None:
    for folder in (CONF_DIR, SWEEPS_DIR):
        trust.check_config_files(folder)


def test_a_folder_of_many_files_is_refused(tmp_path: Path) -> None:
    for number in range(limits.CONFIG_FILES + 1):
        (tmp_path / f"{number}.yaml").touch()
    with pytest.raises(UserError, match=r"at most 1000 \.yaml files, got 1001"):
        trust.check_config_files(tmp_path)
