"""`fishersplat leaderboard`: methods over all studies of a folder."""

import csv
import json
import re
import shutil
from pathlib import Path

import pytest

from framework.command.cli import main as command
from framework.records.search import SEARCH
from framework.report import build_report
from framework.report.leaderboard import leaderboard
from tests.record.fakes import fake_run


def _study(folder: Path, gains: dict[str, float]) -> Path:
    for augment, gain in gains.items():
        for seed in range(4):
            fake_run(folder, augment, seed=seed, gain=gain, run_name=f"{augment}{seed}")
    return build_report(folder).path


def test_methods_over_studies(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "reports"
    _study(folder / "one", {"none": 0.0, "safi": 3.0, "dba": 0.02})
    other = _study(folder / "two", {"none": 0.0, "safi": 3.0, "euclidean": -3.0})
    shutil.rmtree(other.parent / "runs")  # its table remains
    _study(folder / "alone", {"euclidean": 0.0})  # has a row, but no comparison
    assert command(["leaderboard", str(folder)]) == 0
    said = capsys.readouterr().out
    assert said.startswith("Of 4 comparisons") and f"page: {folder / 'leaderboard.html'}" in said
    text = (folder / "leaderboard.md").read_text(encoding="utf-8")
    assert (
        "Of 4 comparisons of methods in 2 studies, significantly better than the baseline: SAFI"
        " (2); significantly worse: Euclidean (1)." in text
    )
    ranks = re.findall(r"^\| (\w+) +\| +\d", text, re.MULTILINE)
    assert ranks[:3] == ["SAFI", "DBA", "Euclidean"]
    assert "[one](one/report.md)" in text and (folder / "leaderboard.html").is_file()
    rows = list(csv.DictReader((folder / "leaderboard.csv").read_text("utf-8").splitlines()))
    assert {row["study"] for row in rows} == {"one", "two"} and len(rows) == 4
    before = (folder / "leaderboard.html").read_bytes()
    leaderboard(folder, folder)
    assert (folder / "leaderboard.html").read_bytes() == before


def test_a_baseline_that_no_study_has(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One that some studies have leaves out the others."""
    for study, augment in (("one", "safi"), ("two", "dba")):
        for seed in range(2):
            fake_run(tmp_path / study, seed=seed)
            fake_run(tmp_path / study, augment, seed=seed, gain=3.0)
    assert command(["leaderboard", str(tmp_path), "--baseline", "xx"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "--baseline: expected a method of the report, got 'xx'; give one of none + none;" in line
    assert "dba + none" in line and "safi + none" in line
    assert not (tmp_path / "leaderboard.md").exists()
    assert command(["leaderboard", str(tmp_path), "--baseline", "safi"]) == 0


def test_searches_are_no_studies(tmp_path: Path) -> None:
    """Nor are runs that were evaluated on training photos: both were made to choose options. The
    differences of a stress study depend on its strength."""
    searched = tmp_path / "searched"
    for folder, condition in ((searched, {}), (tmp_path / "held", {"split": "llff_held_out"})):
        for seed in range(2):
            fake_run(folder, seed=seed, condition=condition, run_name=f"{seed}")
    for views in (2, 3, 4):
        fake_run(tmp_path / "stress", condition={"n_views": views}, run_name=f"{views}")
    actual = '{"metric": "psnr", "fixed": [], "trials": []}'
    (searched / SEARCH).write_text(actual, encoding="utf-8")
    path, studies, _ = leaderboard(tmp_path, tmp_path)
    text = path.read_text(encoding="utf-8")
    assert "| a stress study, whose differences depend on the strength" in text
    assert studies == 0 and "the trials of a search" in text
    assert "evaluated on training photos (scene.split=llff_held_out)" in text


def test_learned_weights_have_their_own_row(tmp_path: Path) -> None:
    for study, weights in (("one", ""), ("two", "IterMVS, dtu")):
        _study(tmp_path / study, {"none": 0.0, "safi": 3.0})
        for file in (tmp_path / study / "runs").glob("*/record.json"):
            record = json.loads(file.read_text(encoding="utf-8"))
            record["provenance"]["learned_weights"] = weights
            file.write_text(json.dumps(record), encoding="utf-8")
    path, *_ = leaderboard(tmp_path, tmp_path)
    text = path.read_text(encoding="utf-8")
    assert "better than the baseline: SAFI (1), SAFI † (1);" in text
    assert "† uses learned weights: IterMVS, dtu." in text
    rows = re.findall(r"^\| (SAFI(?: †)?) +\| +1 \| +1 \|", text, re.MULTILINE)
    assert sorted(rows) == ["SAFI", "SAFI †"]
