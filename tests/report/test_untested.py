"""The report of trainings on every photo, of which none is left to test with."""

from __future__ import annotations

from pathlib import Path

import pytest

from framework.metrics.values import METRICS, Missing
from framework.records.record import read_record, write_failed
from framework.report import build_report
from framework.report.statistics.outcomes import outcomes
from framework.report.statistics.robustness import failure_rate
from framework.report.study.axes import STRESSES
from framework.report.study.collect import collect
from framework.report.study.labels import scene_labels
from framework.report.verdict.lead import UNTESTED, lead
from tests.record.fakes import fake_run, make_config
from tests.report.test_collect import info

ALL = {"n_views": "all", "split": "none"}


def test_the_record_says_why_there_are_no_metrics(tmp_path: Path) -> None:
    record = read_record(fake_run(tmp_path, tested=False) / "record.json")
    assert record.scene is not None
    assert (record.scene.protocol, record.scene.test) == ("none", ())
    assert record.summary == {name: Missing("no test views") for name in METRICS}


@pytest.mark.parametrize("methods", [1, 2])
def test_the_first_screen_says_that_nothing_was_tested(tmp_path: Path, methods: int) -> None:
    for augment, reg in (("none", "none"), ("safi", "uar"))[:methods]:
        for seed in range(3):
            fake_run(tmp_path, augment, reg, seed, condition=ALL, tested=False)
    text = build_report(tmp_path).read_text(encoding="utf-8")
    assert text.splitlines()[2] == f"**{UNTESTED}**"
    (header,) = (
        line for line in text.splitlines() if line.startswith("| Method") and "CPU" in line
    )
    assert "PSNR" not in header
    assert f"PSNR: missing in {3 * methods} of {3 * methods} runs: no test views" in text
    assert "protocol none" in text and "tested on none" in text
    headings = {line for line in text.splitlines() if line.startswith("## ")}
    assert headings == {"## Results", "## Every run", "## Missing metrics", "## Provenance"}
    assert {path.suffix for path in tmp_path.iterdir()} == {"", ".md", ".html", ".csv", ".jsonl"}


def test_budgets_and_stresses_without_test_views(tmp_path: Path) -> None:
    for views in (3, 6, "all"):
        for steps in (100, 200):
            trainer = {"steps": steps, "sh_degree": 0, "members": 1}
            options = {"n_views": views, "split": "none"}
            name = f"{views}-{steps}"
            fake_run(tmp_path, condition=options, tested=False, run_name=name, trainer=trainer)
    assert UNTESTED in build_report(tmp_path).read_text(encoding="utf-8")


def test_a_failed_run_beside_untested_ones(tmp_path: Path) -> None:
    fake_run(tmp_path, condition=ALL, tested=False)
    config = make_config(seed=1, scene={"name": "embedded", **ALL})
    write_failed(tmp_path / "runs" / "x", config, ["seed=1"], "loss: diverged")
    text = build_report(tmp_path).read_text(encoding="utf-8")
    assert "1 of 2 runs failed: listed below." in text
    rate = failure_rate(collect(tmp_path), "none + none")
    assert rate is not None and (rate.failed, rate.n) == (1, 2)


def test_untested_scenes_leave_the_comparison_of_the_others_alone(tmp_path: Path) -> None:
    for seed in range(3):
        for augment, gain in (("none", 0.0), ("safi", 2.0)):
            fake_run(tmp_path / "a", augment, "none", seed, gain, condition={"split": "llff"})
            name = f"all-{augment}-s{seed}"
            more = {"condition": ALL, "tested": False, "run_name": name}
            fake_run(tmp_path / "a", augment, "none", seed, gain, **more)
            fake_run(tmp_path / "b", augment, "none", seed, gain, condition={"split": "llff"})
    mixed, tested = collect(tmp_path / "a"), collect(tmp_path / "b")
    assert len(mixed.scenes) == 2 and len(mixed.tested) == 1
    label = mixed.tested[0]
    assert lead(mixed, outcomes(mixed)).replace(label, "embedded") == lead(tested, outcomes(tested))
    text = build_report(tmp_path / "a").read_text(encoding="utf-8")
    (untested,) = {*mixed.scenes} - {*mixed.tested}
    assert f"Not tested (scene.split=none), hence not compared: {untested}." in text
    assert "mean of all" not in text and "Not on every scene" not in text


def test_all_views_are_a_number_along_the_axis(tmp_path: Path) -> None:
    axis = next(axis for axis in STRESSES if axis.short == "n_views")
    fake_run(tmp_path, condition={"n_views": "all"})
    (run,) = collect(tmp_path).runs
    assert run.record.scene is not None
    assert run.level(axis) == len(run.record.scene.training)
    configs = [make_config(scene={"name": "llff", "n_views": n}) for n in ("all", 3, "all")]
    labels = scene_labels(configs, [info("fern", "11"), info("fern", "22"), None])
    told = ["llff (n_views=all)", "llff (n_views=3)"]
    assert [label.full.replace("fern", "llff") for label in labels] == [*told, told[0]]
    assert [label.data["scene.n_views"] for label in labels] == [1, 3, "all"]
