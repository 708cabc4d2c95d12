"""`fishersplat leaderboard`: methods over all studies of a folder."""

from __future__ import annotations

import csv
import re
import shutil
from pathlib import Path

import pytest

from framework.command.cli import main as command
from framework.errors import UserError
from framework.records.search import SEARCH
from framework.report import build_report
from framework.report.leaderboard import leaderboard
from tests.record.fakes import fake_run


def _study(folder: Path, gains: dict[str, float]) -> Path:
    for augment, gain in gains.items():
        for seed in range(4):
            fake_run(folder, augment, seed=seed, gain=gain, run_name=f"{augment}{seed}")
    return build_report(folder)


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


def test_studies_at_any_depth_are_read(tmp_path: Path) -> None:
    """With their runs or with their table alone."""
    _study(tmp_path / "top", {"none": 0.0, "safi": 3.0})
    other = _study(tmp_path / "mine" / "deep" / "s1", {"none": 0.0, "dba": 3.0})
    shutil.rmtree(other.parent / "runs")
    for name in ("s2", "s3"):
        _study(tmp_path / "mine" / name, {"none": 0.0, "safi": 3.0})
    path, studies, _ = leaderboard(tmp_path, tmp_path / "out")
    text = path.read_text(encoding="utf-8")
    assert studies == 4 and "Left out" not in text
    assert "[mine/deep/s1](../mine/deep/s1/report.md)" in text and "[mine/s3](" in text


def test_conditions_of_a_scene_are_one_scene(tmp_path: Path) -> None:
    for n_views in (2, 3, 6):
        for augment in ("none", "safi"):
            for seed in range(3):
                name = f"{augment}{n_views}{seed}"
                views = {"n_views": n_views}
                fake_run(tmp_path / "one", augment, seed=seed, condition=views, run_name=name)
    leaderboard(tmp_path, tmp_path)
    (row,) = csv.DictReader((tmp_path / "leaderboard.csv").read_text("utf-8").splitlines())
    assert row["scenes"] == "1"
    text = (tmp_path / "leaderboard.md").read_text(encoding="utf-8")
    assert re.search(r"\| +1 \| +3 \| +2 \|", text)  # scenes, seeds, methods


def test_searches_are_no_studies(tmp_path: Path) -> None:
    """Nor are runs that were evaluated on training photos: both were made to choose options."""
    searched = tmp_path / "searched"
    for folder, condition in ((searched, {}), (tmp_path / "held", {"split": "llff_held_out"})):
        for seed in range(2):
            fake_run(folder, seed=seed, condition=condition, run_name=f"{seed}")
    actual = '{"metric": "psnr", "fixed": [], "trials": []}'
    (searched / SEARCH).write_text(actual, encoding="utf-8")
    path, studies, _ = leaderboard(tmp_path, tmp_path)
    text = path.read_text(encoding="utf-8")
    assert studies == 0 and "the trials of a search" in text
    assert "evaluated on training photos (scene.split=llff_held_out)" in text


def test_a_folder_without_studies_and_a_broken_table(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="expected studies with runs"):
        leaderboard(tmp_path, tmp_path / "out")
    (tmp_path / "odd").mkdir()
    (tmp_path / "odd" / "runs.jsonl").write_text("{}\n", encoding="utf-8")
    text = leaderboard(tmp_path, tmp_path / "out")[0].read_text(encoding="utf-8")
    assert "## Left out" in text and "in line 1" in text


def test_a_leaderboard_of_no_study_is_written_and_an_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record = tmp_path / "odd" / "runs" / "x" / "record.json"
    record.parent.mkdir(parents=True)
    record.write_text("{}", encoding="utf-8")
    assert command(["leaderboard", str(tmp_path)]) == 2
    said = capsys.readouterr()
    assert "\nleaderboard: " in said.out and said.err.count("\n") == 1
    assert f"{tmp_path}: expected a study with a finished run, got none" in said.err
    assert "no run of it finished" in (tmp_path / "leaderboard.md").read_text(encoding="utf-8")


def test_the_repository_s_own_studies_are_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _study(tmp_path / "mine", {"none": 0.0, "safi": 3.0})
    _study(tmp_path / "committed" / "ours", {"none": 0.0, "dba": 3.0})
    monkeypatch.setattr("framework.report.leaderboard.COMMITTED", tmp_path / "committed")
    assert leaderboard(tmp_path, tmp_path / "out")[1] == 1
    assert leaderboard(tmp_path / "committed", tmp_path / "out")[1] == 1
    assert leaderboard(tmp_path, tmp_path / "out", "safi")[1] == 1, "compared with SAFI"
