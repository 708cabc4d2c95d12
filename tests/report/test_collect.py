"""Reading the runs of a study: failed, missing, repeated and odd ones, and what is noted."""

import json
from pathlib import Path

import pytest

from framework.errors import UserError
from framework.report import build_report
from framework.report.costs import choices
from framework.report.figures.charts import cost_charts
from framework.report.findings import contests
from framework.report.statistics.outcomes import outcomes
from framework.report.statistics.robustness import failures
from framework.report.study.collect import collect
from tests.record.fakes import fake_run
from tests.report.studies import called, first_screen, labelled


def test_runs_of_different_code_are_told(tmp_path: Path) -> None:
    fake_run(tmp_path, seed=0)
    record = fake_run(tmp_path, seed=1) / "record.json"
    code = collect(tmp_path).runs[0].record.provenance["code"]
    record.write_text(record.read_text().replace(code, "0" * 64))
    assert "2 versions of the code" in first_screen(tmp_path)


def test_a_study_has_no_runs_of_the_studies_in_its_folder(tmp_path: Path) -> None:
    """As of `study=a` and `study=a/b`; a folder of several studies is none."""
    for study in ("a", "a/b", "c"):
        fake_run(tmp_path / study, reg="none" if study == "a" else "uar")
    assert [method.label for method in collect(tmp_path / "a").methods] == ["none + none"]
    assert build_report(tmp_path / "a").path.is_file()
    with pytest.raises(UserError, match=f"of one study, got that of 3; .* as {tmp_path / 'a'}"):
        collect(tmp_path)


def test_a_method_is_compared_under_its_own_options(tmp_path: Path) -> None:
    """The default choices have no name and come first."""
    for augment in ("none", "safi"):
        for name in ("sparse", "stereo"):
            fake_run(tmp_path, augment, init={"name": name}, run_name=f"{augment}{name}")
    study = collect(tmp_path)
    assert [m.label for m in study.methods] == [
        *("none + none", "none + none, init=sparse"),
        *("safi + none", "safi + none, init=sparse"),
    ]
    bases = {m.label: study.baseline_of(m).label for m in study.methods}
    assert bases["safi + none, init=sparse"] == "none + none, init=sparse"
    assert bases["safi + none"] == bases["none + none, init=sparse"] == "none + none"


def _use_learned_weights(run_dir: Path) -> None:
    record = json.loads((run_dir / "record.json").read_text(encoding="utf-8"))
    record["provenance"]["learned_weights"] = "IterMVS, dtu"
    (run_dir / "record.json").write_text(json.dumps(record), encoding="utf-8")


def test_learned_weights_are_a_separate_league(tmp_path: Path) -> None:
    runs = [fake_run(tmp_path, reg=reg, seed=0) for reg in ("none", "uar")]
    assert "Do not compare" not in first_screen(tmp_path)
    for run_dir in runs:
        _use_learned_weights(run_dir)
        named = "Every method" if run_dir == runs[-1] else "Baseline †"
        text = first_screen(tmp_path)
        assert f"{named} used networks that were trained on other scenes" in text
        assert "(marked †): IterMVS, dtu. Do not compare" in text


def test_learned_weights_are_marked_in_the_results(tmp_path: Path) -> None:
    for reg in ("none", "uar"):
        run_dir = fake_run(tmp_path, reg=reg, seed=0)
    _use_learned_weights(run_dir)
    build_report(tmp_path)
    for name, mark in (("results.md", "†"), ("results.tex", r"$\dagger$"), ("report.md", "†")):
        text = (tmp_path / name).read_text(encoding="utf-8")
        assert f"UAR {mark}" in text and f"Baseline {mark}" not in text
        assert f"{mark} uses learned weights: IterMVS, dtu." in text
    study = collect(tmp_path)
    assert study.methods[1].is_called("uar") and study.methods[1].is_called("UAR")


def test_capacities_are_compared_all_else_equal(tmp_path: Path) -> None:
    """Each with the fixed number, under the same method and the same other budgets."""
    for seed in range(3):
        for reg in ("none", "uar"):
            for name, gain in (("fixed", 0.0), ("adc", 2.0), ("budget", -3.0)):
                run_name = f"{reg}-{name}-{seed}"
                capacity = {"name": name, "weight": 1.0}
                fake_run(tmp_path, "none", reg, seed, gain, run_name=run_name, capacity=capacity)
    actual = contests(collect(tmp_path))
    pairs = [(c.method.label, dict(c.comparison.method.capacity)["capacity"]) for c in actual]
    assert pairs == [(m, c) for m in ("none + none", "none + uar") for c in ("adc", "budget")]
    assert all(not c.comparison.baseline.capacity and c.comparison.tests == 4 for c in actual)
    assert [round(c.comparison.difference) for c in actual] == [2, -3, 2, -3]
    assert all(c.comparison.n == 3 and c.parameters == 1.0 for c in actual)


def test_a_budget_without_the_baseline_has_no_comparison(tmp_path: Path) -> None:
    """As where plain training failed there: another method is no baseline in its place."""
    for augment, reg, steps in (
        *(("none", "none", 100), ("none", "uar", 100)),
        *(("none", "uar", 400), ("safi", "none", 400)),
    ):
        for seed in range(3):
            fake_run(
                *(tmp_path, augment, reg, seed),
                gain=6.0 if augment == "safi" else 0.0,
                trainer={"steps": steps},
                run_name=f"{augment}{reg}{steps}{seed}",
            )
    study = collect(tmp_path)
    assert [m.label for m in study.baselines] == ["none + none, steps=100"]
    alone = ["none + uar, steps=400", "safi + none, steps=400"]
    assert [m.label for m in study.without_baseline] == alone
    assert all(study.baseline_of(m) == m for m in study.without_baseline)
    assert list(labelled(outcomes(study).comparisons)) == ["none + uar, steps=100"]
    # 6 dB below safi, which is no plain one
    assert failures(study, called(study, "none + uar, steps=400"), "embedded")[0] == 0
    text = build_report(tmp_path).path.read_text(encoding="utf-8")
    assert "Not compared, because no baseline has the same budget: UAR, steps=400; SAFI," in text


def test_a_failed_run_without_a_record_is_listed(tmp_path: Path) -> None:
    fake_run(tmp_path, "safi", seed=0)
    folder = tmp_path / "runs" / "x"
    folder.mkdir()
    content = {"error": "no overlap", "kind": "", "overrides": ["seed=1"], "again": ""}
    (folder / "failed.json").write_text(json.dumps(content))
    (failed,) = collect(tmp_path).failed
    assert (failed.record.error, failed.record.overrides, failed.seed) == (
        "no overlap",
        ("seed=1",),
        None,
    )
    (folder / "failed.json").write_text("{")
    (damaged,) = collect(tmp_path).failed
    error = damaged.record.error or ""
    assert damaged.kind == "damaged" and error.startswith("failed.json: expected JSON")


def test_trainings_beside_other_programs_are_told_and_compared_by_cpu(tmp_path: Path) -> None:
    fake_run(tmp_path, "none", "none", 0)
    fake_run(tmp_path, "safi", "none", 0)
    assert not collect(tmp_path).by_cpu
    busy = fake_run(tmp_path, "none", "none", 1) / "record.json"
    content = json.loads(busy.read_text(encoding="utf-8"))
    (train,) = (stage for stage in content["timings"] if stage["stage"] == "train")
    train["cpu_s"] = 5.0
    busy.write_text(json.dumps(content), encoding="utf-8")
    study = collect(tmp_path)
    assert "the processor during 1 of 3 trainings" in first_screen(tmp_path)
    ((chart,), *_) = cost_charts(study, "embedded")
    assert chart.x_label == "training time (s, CPU)"
    assert study.by_cpu and choices(study, "embedded")


def test_every_capacity_is_a_series(tmp_path: Path) -> None:
    for name in ("fixed", "adc"):
        for steps in (100, 400):
            config = {"capacity": {"name": name}, "trainer": {"steps": steps}}
            fake_run(tmp_path, gain=steps / 100, run_name=f"{name}{steps}", **config)
    ((chart,), *_) = cost_charts(collect(tmp_path), "embedded")
    assert {series.name for series in chart.series} == {
        "Baseline",
        "Baseline, capacity=adc",
    }
