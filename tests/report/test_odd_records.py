"""One odd record costs a study's report that run alone."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from framework.command.cli import main as command
from framework.report.study.collect import collect
from framework.report.study.study import DAMAGED
from tests.record.fakes import fake_run


@pytest.mark.parametrize(
    ("group", "option", "value"),
    [
        ("trainer", "steps", "many"),
        ("trainer", "steps", 1e300),
        ("trainer", "steps", True),
        ("trainer", "lr_scale", "x"),
        ("init", "budget", {"a": {"b": 1}}),
        ("scene", "n_views", {"a": 1}),
    ],
)
def test_it_is_listed_as_damaged(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], group: str, option: str, value: Any
) -> None:
    fake_run(tmp_path, "none")
    path = fake_run(tmp_path, "safi") / "record.json"
    record = json.loads(path.read_text())
    record["config"][group][option] = value
    path.write_text(json.dumps(record))
    assert command(["report", str(tmp_path)]) == 0
    assert command(["report", str(tmp_path)]) == 0, capsys.readouterr().err  # from its own table
    (failed,) = collect(tmp_path).failed
    assert failed.kind == DAMAGED and f"config.{group}.{option}" in failed.error


def test_runs_that_cannot_be_read_are_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    fake_run(tmp_path)
    assert command(["report", str(tmp_path)]) == 0

    def refuse(folder: Path) -> Any:
        if Path(folder).name == "runs":
            raise PermissionError(13, "Permission denied", str(folder))
        return scandir(folder)

    import os

    scandir = os.scandir
    monkeypatch.setattr(os, "scandir", refuse)
    assert command(["report", str(tmp_path)]) == 2
    assert "runs: expected what may be opened, got 'Permission denied'" in capsys.readouterr().err
