"""`fishersplat compare`: two runs beside each other, and what is no pair of runs."""

from __future__ import annotations

import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from framework.command.cli import main as command
from framework.errors import UserError
from framework.records.run_files import Table
from framework.report.pair import _views as pair_views
from framework.report.pair import compare_runs
from framework.report.study.study import ReportRun
from framework.report.tables import heading_of
from tests.record.fakes import fake_run


def test_two_runs_beside_each_other(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plain, safi = fake_run(tmp_path, run_name="a"), fake_run(tmp_path, "safi", gain=1.0)
    out = tmp_path / "out"
    assert command(["compare", str(plain), str(safi), "--out", str(out)]) == 0
    verdict, page, compared = capsys.readouterr().out.splitlines()
    assert verdict.startswith("SAFI reaches") and page == f"page: {out / 'compare.html'}"
    assert compared == f"compared: {out / 'compare.md'}"
    text = (out / "compare.md").read_text(encoding="utf-8")
    assert text.startswith("# SAFI compared with Baseline\n")
    assert re.search(r"\*\*SAFI reaches \d+\.\d\d dB on embedded, \d\.\d\d dB above", text)
    assert "Single runs cannot distinguish a method from chance" in text
    assert re.search(r"\| augment\.name +\| +none +\| +safi", text)
    for name in ("compare.html", "closeup_embedded.jpg", "curves.svg", "curves.csv"):
        assert (out / name).is_file()
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    compare_runs(plain, safi, out)
    assert {path.name: path.read_bytes() for path in out.iterdir()} == before


def test_runs_of_one_method_are_told_apart_by_seed(tmp_path: Path) -> None:
    runs = [fake_run(tmp_path, seed=seed, run_name=f"s{seed}") for seed in (0, 1)]
    text = compare_runs(*runs, tmp_path / "out")[0].read_text(encoding="utf-8")
    assert text.startswith("# Baseline, seed=1 compared with Baseline, seed=0\n")
    assert re.search(r"\| seed +\| +0 +\| +1", text)


def test_what_is_no_pair_of_runs_ends_in_one_line(tmp_path: Path) -> None:
    run = fake_run(tmp_path)
    with pytest.raises(UserError, match="expected the folder of a run, got none with record"):
        compare_runs(run, tmp_path, tmp_path / "out")
    with pytest.raises(UserError, match="expected two runs, got one twice"):
        compare_runs(run, run, tmp_path / "out")


def test_different_scenes_are_not_compared(tmp_path: Path) -> None:
    runs = [fake_run(tmp_path, scene=name, run_name=name) for name in ("fern", "fox")]
    text = compare_runs(*runs, tmp_path / "out")[0].read_text(encoding="utf-8")
    assert "Different scenes, so not compared: fern and fox." in text


def test_a_metric_that_one_run_alone_has_is_shown_whichever_comes_first() -> None:
    def measured(method: str, **numbers: float) -> ReportRun:
        table = Table({"view": ["v"]}, {k: np.array([x]) for k, x in numbers.items()})
        actual: Any = SimpleNamespace(
            method=method, run=SimpleNamespace(metrics=table), mean=numbers.get, psnr={"v": 1.0}
        )
        return actual  # type: ignore[no-any-return]

    few, more = measured("a", psnr=20.0), measured("b", psnr=21.0, lpips=0.25, avge=0.1)
    for pair, absent in (((few, more), 0), ((more, few), 1)):
        (row,) = pair_views(*pair)
        message = [row[f"{heading_of('lpips')}, {run.method}"] for run in pair]
        assert message[absent] == "–" and message[1 - absent] == "0.2500"
        assert row[f"{heading_of('avge')}, b"] == "0.1000"
