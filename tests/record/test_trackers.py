"""A finished run goes to a tracker, once, and no tracker harms it. MLflow, Weights & Biases and
trackio are stand-in modules here, which record the calls; TensorBoard is the real one."""

import json
import sys
from pathlib import Path
from typing import Any

import pytest

from framework.command.cli import main
from framework.records.record import read_run
from framework.run import trackers
from tests.record.fakes import fake_run
from tests.record.test_reuse import group, small_config
from tests.record.test_reuse import run as done

STAND_IN = """
import contextlib
calls = []
class Session:
    summary = None
    def __enter__(self): return self
    def __exit__(self, *error): calls.append(["end"])
    def __getattr__(self, name):
        return lambda *args, **named: calls.append([name, list(args), named])
class Wandb(Session):
    @property
    def summary(self): return self
def init(**named):
    calls.append(["init", named])
    return Wandb()
def start_run(**named):
    calls.append(["start_run", named])
    return Session()
def __getattr__(name):
    if name.startswith("__"):
        raise AttributeError(name)
    return lambda *args, **named: calls.append([name, list(args), named])
"""


class Notes:
    """A progress that keeps its notes."""

    def __init__(self) -> None:
        self.notes: list[str] = []

    def note(self, text: str) -> None:
        self.notes.append(text)


def sent(name: str, run_dir: Path) -> list[str]:
    progress: Any = Notes()
    trackers.send(name, run_dir, progress)
    return progress.notes


@pytest.fixture
def stand_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Makes a module of a tracker's name importable and returns it."""

    def make(name: str, text: str = STAND_IN) -> Any:
        folder = tmp_path / "modules"
        folder.mkdir(exist_ok=True)
        (folder / f"{name}.py").write_text(text)
        monkeypatch.syspath_prepend(str(folder))
        monkeypatch.delitem(sys.modules, name, raising=False)
        module = __import__(name)
        del sys.modules[name]  # or it would be put back after the test
        monkeypatch.setitem(sys.modules, name, module)
        return module

    return make


def test_what_a_tracker_gets(tmp_path: Path) -> None:
    run = read_run(fake_run(tmp_path / "study", "safi", "uar"))
    got = trackers.tracked(run)
    assert (got.study, got.name) == ("study", run.run_dir.name)
    assert got.options["augment.name"] == "safi" and got.options["metrics.lpips_weights"] == "null"
    assert [step for step, _ in got.rows] == list(run.history.numbers["step"])
    assert got.rows[-1][1]["loss"] == run.history.numbers["loss"][-1]
    assert got.summary["summary/psnr"] == run.record.summary["psnr"]
    assert got.summary["summary/gaussians"] == run.record.gaussians
    assert "summary/lpips" not in got.summary  # was not measured


def test_a_record_is_sent_once(tmp_path: Path, stand_in: Any) -> None:
    module, run_dir = stand_in("mlflow"), fake_run(tmp_path / "study")
    sent("mlflow", run_dir)
    n_calls = len(module.calls)
    sent("mlflow", run_dir)
    assert len(module.calls) == n_calls
    record = run_dir / "record.json"
    record.write_text(record.read_text() + "\n")  # as one that was measured again
    sent("mlflow", run_dir)
    assert len(module.calls) == 2 * n_calls


def test_a_missing_package_is_told_before_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    monkeypatch.setattr("sys.argv", ["run.py"])
    monkeypatch.chdir(tmp_path)
    assert main(["tracker=mlflow"]) == 2
    assert "pip install 'fishersplat[mlflow]'" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_tensorboard_holds_the_run(tmp_path: Path) -> None:
    """A real run, sent when it was complete already and not repeated for it."""
    pytest.importorskip("tensorboard", reason="the extra `tensorboard` is not installed here")
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    config, folder = small_config(group("depth", "plane_sweep")), tmp_path / "run"
    first, reused = done(config, folder)
    assert not reused and not (folder / "tracker").exists()
    for _ in range(2):
        again, reused = done({**config, "tracker": "tensorboard"}, folder)
        assert reused and again == first
    events = EventAccumulator(str(folder / "tracker"))
    events.Reload()
    history = read_run(folder).history.numbers
    for name in ("loss", "gaussians"):
        read = events.Scalars(name)
        assert [event.step for event in read] == list(history["step"])
        assert [event.value for event in read] == pytest.approx(list(history[name]), rel=1e-6)
    psnr = events.Scalars("summary/psnr")
    assert [event.value for event in psnr] == pytest.approx([first.summary["psnr"]], rel=1e-6)
    started = events.PluginTagToContent("hparams")["_hparams_/session_start_info"]
    assert b"trainer.steps" in started


@pytest.mark.parametrize("name", ["mlflow", "wandb", "trackio"])
def test_the_calls_of_a_tracker(name: str, tmp_path: Path, stand_in: Any) -> None:
    module = stand_in(name)
    run_dir = fake_run(tmp_path / "study")
    got = trackers.tracked(read_run(run_dir))
    assert sent(name, run_dir) == []
    message = json.dumps(module.calls)
    assert run_dir.name in message and '"study"' in message and '"summary/psnr"' in message
    steps = [call[2]["step"] for call in module.calls if len(call) == 3 and "step" in call[2]]
    rows = [step for step, _ in got.rows]
    assert steps == rows + (rows[-1:] if name == "trackio" else [])
    assert module.calls[-1][0] in ("end", "finish")


def test_a_failure_is_one_warning_and_is_tried_again(tmp_path: Path, stand_in: Any) -> None:
    stand_in("mlflow", "def set_experiment(name):\n    raise OSError('no\\nnetwork')\n")
    run_dir = fake_run(tmp_path / "study")
    before = (run_dir / "record.json").read_bytes()
    for _ in range(2):
        (note,) = sent("mlflow", run_dir)
        assert note.startswith("warning: tracker=mlflow: not sent (OSError: no network)")
    assert (run_dir / "record.json").read_bytes() == before
