"""A report from a table of runs says what one from the runs says, as far as the table goes."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from framework.errors import UserError
from framework.records.provenance import ROOT
from framework.report import build_report
from framework.report.statistics.outcomes import outcomes
from framework.report.study.axes import STRESSES
from framework.report.study.collect import collect
from framework.report.study.labels import MethodLabel
from framework.report.study.tabled import method_label
from framework.report.text import searched
from tests.record.fakes import fake_run


def _study(folder: Path) -> Path:
    for augment, gain in (("none", 0.0), ("safi", 1.0)):
        for seed in range(3):
            fake_run(folder, augment, seed=seed, gain=gain, run_name=f"{augment}{seed}")
    return build_report(folder)


def _table(report: Path, folder: Path) -> Path:
    folder.mkdir()
    shutil.copy(report.with_name("runs.csv"), folder / "runs.csv")
    return folder


def _verdict(report: Path) -> str:
    return next(x for x in report.read_text(encoding="utf-8").splitlines() if x.startswith("**"))


def _section(report: Path, heading: str) -> str:
    return report.read_text(encoding="utf-8").partition(f"## {heading}\n")[2].partition("\n## ")[0]


def test_the_same_verdict_and_figures_from_the_table_alone(tmp_path: Path) -> None:
    report = _study(tmp_path / "runs")
    again = build_report(_table(report, tmp_path / "table"), "runs")
    assert _verdict(again) == _verdict(report) != ""
    assert _section(again, "Results") == _section(report, "Results")
    assert _section(again, "Comparisons") == _section(report, "Comparisons")
    told = (report.parent / "differences.csv").read_text(encoding="utf-8")
    assert (again.parent / "differences.csv").read_text(encoding="utf-8") == told
    assert "Built from the table `runs.csv` alone" in again.read_text(encoding="utf-8")


def test_no_report_of_a_table_alone_takes_the_place_of_one_of_runs(tmp_path: Path) -> None:
    """A table and its report are what is passed on."""
    folder = _table(_study(tmp_path / "runs"), tmp_path / "table")
    shutil.copy(tmp_path / "runs" / "report.md", folder)
    fuller = (folder / "report.md").read_text(encoding="utf-8")
    with pytest.raises(UserError, match=r"table: expected runs, got their table alone .* --out"):
        build_report(folder)
    assert (folder / "report.md").read_text(encoding="utf-8") == fuller
    assert build_report(folder, out_dir=tmp_path / "other").exists()


def test_a_new_run_does_not_take_the_place_of_a_table_whose_runs_are_gone(tmp_path: Path) -> None:
    """What a study passed on as a table held was lost when it got one more seed."""
    folder = _table(_study(tmp_path / "runs"), tmp_path / "table")
    before = (folder / "runs.csv").read_text(encoding="utf-8")
    fake_run(folder, "none", seed=7, run_name="none7")
    with pytest.raises(UserError, match=r"got one with 6 others \(as none0\), whose folders are"):
        build_report(folder)
    assert (folder / "runs.csv").read_text(encoding="utf-8") == before
    together = build_report([folder, tmp_path / "runs"], out_dir=tmp_path / "other")
    assert len((together.parent / "runs.csv").read_text(encoding="utf-8").splitlines()) == 8


def test_a_run_that_was_repeated_takes_its_place_in_the_table(tmp_path: Path) -> None:
    folder = _study(tmp_path / "runs").parent
    before = (folder / "runs.csv").read_text(encoding="utf-8")
    fake_run(folder, "safi", seed=2, gain=2.0, run_name="safi2")
    build_report(folder)
    assert (folder / "runs.csv").read_text(encoding="utf-8") != before


def test_a_table_is_read_back_to_the_same_runs(tmp_path: Path) -> None:
    report = _study(tmp_path / "runs")
    before = collect(report.parent)
    after = collect(_table(report, tmp_path / "table"))
    for own, other in zip(before.runs, after.runs, strict=True):
        assert (own.scene, own.method, own.seed) == (other.scene, other.method, other.seed)
        assert own.mean("psnr") == other.mean("psnr")
        assert own.record.parameters == other.record.parameters
        assert own.record.train_s == other.record.train_s
    assert after.tabled and not after.linked


def test_doses_are_in_the_table(tmp_path: Path) -> None:
    dose = {"views_asked": 42, "views_made": 5, "how": "never asked", "acted_share": 0.12}
    for augment in ("none", "safi"):
        path = fake_run(tmp_path / "runs", augment) / "record.json"
        if augment == "safi":
            path.write_text(json.dumps(json.loads(path.read_text()) | {"dose": dose}))
    report = build_report(tmp_path / "runs")
    again = build_report(_table(report, tmp_path / "table"), "runs")
    assert [run.record.dose for run in collect(again.parent).runs] == [{}, dose]
    told = _section(report, "What each method did")
    assert "never asked" in told and _section(again, "What each method did") == told
    assert "acted on less than half of its occasions: safi + none (12 %" in again.read_text()


def test_a_table_goes_on_with_runs_and_nothing_of_either_is_missing(tmp_path: Path) -> None:
    old = tmp_path / "old"
    for augment, seeds in (("none", (0, 1)), ("safi", (0,))):
        for seed in seeds:
            fake_run(old, augment, seed=seed, run_name=f"{augment}{seed}")
    table = _table(build_report(old), tmp_path / "table")
    assert "1 run is missing" in (old / "report.md").read_text(encoding="utf-8")
    new = tmp_path / "new"
    fake_run(new, "safi", seed=1, run_name="safi1")
    fake_run(new, "none", seed=2, run_name="none2")
    both = collect([table, new], tmp_path / "both")
    assert len(both.runs) == 5
    assert both.missing == (("embedded", "safi + none", 2),), "seed 1 of none is in the table"
    assert any(note.startswith("3 of 5 runs are those of a table") for note in both.notes)


def test_a_run_in_a_table_and_in_a_folder_is_one(tmp_path: Path) -> None:
    report = _study(tmp_path / "runs")
    table = _table(report, tmp_path / "table")
    shutil.rmtree(report.parent / "runs" / "safi2")
    both = collect([report.parent, table], tmp_path / "both")
    assert [run.run.run_dir.parent.parent.name for run in both.runs] == ["runs"] * 5 + ["table"]
    assert not [note for note in both.notes if "twice" in note]
    assert any(note.startswith("1 of 6 runs are those of a table") for note in both.notes)


def test_a_table_of_runs_that_are_all_there_takes_nothing_away(tmp_path: Path) -> None:
    report = _study(tmp_path / "runs")
    both = collect([report.parent, _table(report, tmp_path / "table")], tmp_path / "both")
    assert len(both.runs) == 6 and both.linked and not both.tabled


def test_a_figure_kept_beside_the_table_is_shown(tmp_path: Path) -> None:
    report = _study(tmp_path / "runs")
    folder = _table(report, tmp_path / "table")
    scene = collect(folder).scenes[0]
    shutil.copy(report.with_name(f"images_{scene}.jpg"), folder)
    text = build_report(folder).read_text(encoding="utf-8")
    assert f"(images_{scene}.jpg)" in text and "Drawn when the runs were made" in text


def test_the_parts_of_a_method_are_read_from_its_name() -> None:
    name = "safi + uar, augment.eta=0.5, steps=75, members=2, capacity=adc, every=0.1"
    limits = "steps=75, members=2"
    label = MethodLabel("safi + uar", "augment.eta=0.5", limits, "capacity=adc, every=0.1")
    assert method_label(name) == label and label.full == name


@pytest.mark.parametrize(
    "change",
    [
        ("scene,", "place,"),
        ("none + none", ""),
        (",none + none,0,", ",none + none,zero,"),
        (",none + none,0,", ",none + none,0,7,"),
        ("none0", ".."),
    ],
)
def test_another_table_ends_in_one_line(tmp_path: Path, change: tuple[str, str]) -> None:
    folder = _table(_study(tmp_path / "runs"), tmp_path / "table")
    text = (folder / "runs.csv").read_text(encoding="utf-8")
    assert change[0] in text
    (folder / "runs.csv").write_text(text.replace(*change, 1), encoding="utf-8")
    with pytest.raises(UserError, match=r"runs\.csv: expected a table of runs"):
        collect(folder)


@pytest.mark.parametrize(
    ("column", "value"),
    [
        *(("psnr", value) for value in ("1e300", "-1e300", "inf", "nan", "1" * 500)),
        ("train_wall_s", "1e300"),
    ],
)
def test_numbers_that_no_axis_can_have_end_in_one_line(
    tmp_path: Path, column: str, value: str
) -> None:
    folder = _table(_study(tmp_path / "runs"), tmp_path / "table")
    heads, first, *rest = (folder / "runs.csv").read_text(encoding="utf-8").splitlines()
    cells = first.split(",")
    cells[heads.split(",").index(column)] = value
    (folder / "runs.csv").write_text("\n".join([heads, ",".join(cells), *rest]) + "\n")
    with pytest.raises(UserError, match=r"runs\.csv: expected a table of runs"):
        collect(folder)


COMMITTED = sorted((ROOT / "reports" / "committed").glob("*/runs.csv"))


@pytest.mark.parametrize("table", COMMITTED, ids=lambda path: path.parent.name)
def test_every_committed_report_opens_with_its_verdict(table: Path) -> None:
    """It says so of the runs of its table: the first lines are what that table gives today."""
    study = collect(table.parent)
    found = outcomes(study)
    text = (table.parent / "report.md").read_text(encoding="utf-8")
    _, shown, behind = text.split("\n\n")[:3]
    alone = len({run.seed for run in study.runs}) == 1  # single runs are no ground for advice
    assert shown.startswith("**No advice: single runs" if alone else "**Use ")
    assert shown.endswith("**")
    assert all(
        c.method in shown + behind for c in found.comparisons.values() if c.significant
    ) or any(run.level(axis) is not None for run in study.runs for axis in STRESSES)


def test_a_scene_with_parentheses_keeps_its_name(tmp_path: Path) -> None:
    for scene in ("chair (1)", "chair (2)"):
        for views in (3, 6):
            name, given = f"{scene[-2]}{views}", {"n_views": views}
            fake_run(tmp_path / "runs", scene=scene, condition=given, run_name=name)
    report = build_report(tmp_path / "runs")
    study, again = collect(tmp_path / "runs"), collect(_table(report, tmp_path / "table"))
    assert study.scenes == again.scenes and len(study.scenes) == 4
    assert [again.name_of(s) for s in again.scenes] == [study.name_of(s) for s in study.scenes]


def test_a_table_says_that_views_were_held_out(tmp_path: Path) -> None:
    """So does one of before, which has no column for it, where the split was typed."""
    for seed in range(2):
        fake_run(tmp_path / "runs", seed=seed, condition={"split": "llff_held_out"})
    folder = _table(build_report(tmp_path / "runs"), tmp_path / "table")
    assert searched.HELD_OUT in build_report(folder).read_text(encoding="utf-8")
    assert [run.protocol for run in collect(folder).runs] == ["llff_held_out"] * 2
    assert not collect(folder).split_as_published("embedded")
    table = folder / "runs.csv"
    text = table.read_text(encoding="utf-8")
    before = text.replace("llff_held_out", "").replace(",protocol,", ",other,")
    table.write_text(before.replace("+reg=none", "+reg=none scene.split=llff_drawn3"))
    assert {run.protocol for run in collect(folder).runs} == {"llff_drawn3"}
    table.write_text(before)
    assert {run.protocol for run in collect(folder).runs} == {""}
    table.write_text(text.replace(",protocol,", ",scene.split,"))
    assert {run.protocol for run in collect(folder).runs} == {"llff_held_out"}


def test_equal_results_of_all_seeds_are_told(tmp_path: Path) -> None:
    """They have intervals of no width, which look like certainty."""
    report = _study(tmp_path / "runs")
    assert "The same PSNR with every seed" not in report.read_text(encoding="utf-8")
    rows = [line.split(",") for line in (tmp_path / "runs/runs.csv").read_text().splitlines()]
    for row in rows[1:]:
        row[rows[0].index("psnr")] = "21.5" if row[1] == "safi + none" else "20.5"
    (tmp_path / "table").mkdir()
    (tmp_path / "table" / "runs.csv").write_text("\n".join(map(",".join, rows)) + "\n")
    text = build_report(tmp_path / "table").read_text(encoding="utf-8")
    assert "The same PSNR with every seed: none + none and safi + none on embedded." in text
    assert "as one of them does not vary" in text and "share too few seeds" not in text
