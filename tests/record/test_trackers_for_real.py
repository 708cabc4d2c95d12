"""The trackers' own packages write to the disk, and what they wrote is read back. Each runs in
a separate process, as they keep threads and settings; skipped where the extra is not installed."""

from __future__ import annotations

import glob
import importlib.util
import json
import os
import sqlite3
import subprocess
import sys
from pathlib import Path

import pytest

from framework.command.config.schema import ROOT
from framework.records.record import read_run
from framework.run import trackers
from tests.record.fakes import fake_run

SEND = """
import sys
from pathlib import Path
from framework.run import trackers
class Progress:
    def note(self, text): sys.exit(text)
trackers.send(sys.argv[1], Path(sys.argv[2]), Progress())
"""
MLFLOW = """
import json, mlflow
(run,) = mlflow.search_runs(search_all_experiments=True, output_format="list")
steps = mlflow.MlflowClient().get_metric_history(run.info.run_id, "loss")
print(json.dumps([run.data.metrics, run.data.params, [[m.step, m.value] for m in steps]]))
"""


def process(folder: Path, code: str, *words: str) -> str:
    """What a Python program printed, run in `folder`, with all trackers confined to it."""
    places = {
        "MLFLOW_TRACKING_URI": (folder / "mlruns").as_uri(),
        "MLFLOW_ALLOW_FILE_STORE": "true",
        "WANDB_MODE": "offline",
        "TRACKIO_DIR": str(folder / "trackio"),
        "HOME": str(folder),
        "PYTHONPATH": str(ROOT),
    }
    done = subprocess.run(
        [sys.executable, "-c", code, *words],
        cwd=folder,
        env={**os.environ, **places},
        capture_output=True,
        text=True,
        timeout=400,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def sent(tracker: str, folder: Path) -> trackers.Tracked:
    """A run that was sent by a process that printed nothing about it."""
    if importlib.util.find_spec(tracker) is None:
        pytest.skip(f"the extra `{tracker}` is not installed here")
    run_dir = fake_run(folder / "study")
    assert process(folder, SEND, tracker, str(run_dir)) == ""
    return trackers.tracked(read_run(run_dir))


def test_mlflow_holds_the_run(tmp_path: Path) -> None:
    run = sent("mlflow", tmp_path)
    metrics, params, losses = json.loads(process(tmp_path, MLFLOW))
    assert metrics["summary/psnr"] == pytest.approx(run.summary["psnr"])
    assert params["trainer.steps"] == str(run.options["trainer.steps"])
    assert losses == [[step, pytest.approx(values["loss"])] for step, values in run.rows]


def test_wandb_holds_the_run(tmp_path: Path) -> None:
    """Its file is a log of protobuf messages, whose values are JSON texts."""
    run = sent("wandb", tmp_path)
    (log,) = glob.glob(str(run.folder / "wandb" / "offline-run-*" / "*.wandb"))
    written = Path(log).read_bytes()
    message = [*(values["loss"] for _, values in run.rows), run.summary["psnr"]]
    for text in ("trainer.steps", "summary/psnr", *(json.dumps(value)[:12] for value in message)):
        assert text.encode() in written, text


def test_trackio_holds_the_run(tmp_path: Path) -> None:
    run = sent("trackio", tmp_path)
    (database,) = (tmp_path / "trackio").rglob("*.db")
    with sqlite3.connect(database) as opened:
        rows = opened.execute("select step, metrics from metrics order by id").fetchall()
        (config,) = opened.execute("select config from configs").fetchone()
    last = run.rows[-1][0]
    wanted = [*run.rows, (last, {f"summary/{name}": v for name, v in run.summary.items()})]
    assert [(step, json.loads(metrics)) for step, metrics in rows] == [
        (step, pytest.approx(dict(values))) for step, values in wanted
    ]
    assert json.loads(config)["trainer.steps"] == run.options["trainer.steps"]
