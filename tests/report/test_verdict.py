"""The verdict: what it claims, what it does not, and what it says about the study's power."""

from __future__ import annotations

import json
import re
import shutil
from itertools import product
from pathlib import Path

import pytest

from framework.errors import UserError
from framework.metrics.values import METRICS, Missing
from framework.records.record import POSE_CHECK, read_record, write_failed
from framework.report import build_report
from framework.report.figures.forest import forest_of
from framework.report.figures.views import choose_views
from framework.report.findings import find
from framework.report.statistics.outcomes import outcomes
from framework.report.statistics.robustness import failure_rate
from framework.report.study.collect import collect
from tests.record.fakes import fake_run, make_config
from tests.report.studies import called, first_screen, labelled, write_committed

GAINS = {("none", "none"): 0.0, ("none", "uar"): 1.0, ("safi", "none"): 1.6}
ALL = {"n_views": "all", "split": "none"}


def write(folder: Path, gains: dict[str, float], seeds: int, **more: object) -> None:
    for augment, gain in gains.items():
        for seed in range(seeds):
            fake_run(folder, augment, seed=seed, gain=gain, **more)  # type: ignore[arg-type]


def test_a_winner_is_advised_with_its_gain(tmp_path: Path) -> None:
    for augment, reg, gain in (("none", "none", 0.0), ("safi", "uar", 2.0)):
        for seed in range(3):
            fake_run(tmp_path, augment, reg, seed, gain)
    text = first_screen(tmp_path)
    assert re.search(
        r"\*\*Use SAFI \+ UAR: it gains \d\.\d+ dB \(95 % CI \d\.\d+ to \d\.\d+\) compared with the"
        r" baseline on embedded\.\*\*",
        text,
    )
    assert ", not significant" not in text
    assert "Cost of a training: SAFI + UAR 18.1 s" in text and "Baseline 16.1 s" in text


def test_every_difference_is_stated_with_its_power(tmp_path: Path) -> None:
    write(tmp_path, {"none": 0.0, "safi": -2.0, "dba": 0.02, "euclidean": -3.0}, 4)
    text = first_screen(tmp_path)
    assert "**Use the baseline on embedded: no other method is significantly better.**" in text
    differences = re.findall(
        r"^- (\S+): -\d\.\d+ dB \(95 % CI \S+ to \S+\), significant\.", text, re.M
    )
    assert differences == ["Euclidean", "SAFI"], "the largest loss first"
    assert re.search(
        r"- DBA: \+0\.\d+ dB \(95 % CI -\d.+\), not significant; an effect of up to \d\S+ dB cannot"
        r" be ruled out with 4 seeds\.",
        text,
    )
    assert "Seed-to-seed spread (σ): no significant difference" in text


def test_who_is_as_good_as_the_best_is_listed(tmp_path: Path) -> None:
    write(tmp_path, {"none": 0.0, "safi": 2.0, "dba": 2.0, "euclidean": -1.0}, 4)
    text = first_screen(tmp_path)
    best, other = ("SAFI", "DBA") if "**Use SAFI" in text else ("DBA", "SAFI")
    assert f"**Use {best}: it gains" in text
    assert f"- Not significantly different from {best}: {other} (" in text


def test_one_method_is_nothing_to_compare_and_the_baseline_is_a_command(tmp_path: Path) -> None:
    fake_run(tmp_path / "mine", "safi", "uar")
    assert "in a single run (n = 1), whose variation is unknown" in first_screen(tmp_path / "mine")
    for seed in (1, 2):
        fake_run(tmp_path / "mine", "safi", "uar", seed=seed)
    text = first_screen(tmp_path / "mine")
    assert re.search(r"Nothing to compare: on embedded, SAFI \+ UAR reaches .*n = 3 seeds, σ", text)
    assert "`fishersplat method=baseline seed=0,1,2 study=mine -m`" in text
    assert "Cost of a training: SAFI + UAR" in text
    fake_run(tmp_path / "plain")
    assert "method=baseline" not in first_screen(tmp_path / "plain")


def test_single_runs_and_strangers_are_no_evidence(tmp_path: Path) -> None:
    fake_run(tmp_path, seed=0)
    fake_run(tmp_path, "safi", seed=1, gain=1.0)
    assert "no method shares a scene, a seed and options with the baseline" in first_screen(
        tmp_path
    )
    assert [run.seed for run in choose_views(collect(tmp_path), "embedded").runs] == [0, 1]
    fake_run(tmp_path, "safi", seed=0, gain=1.0)
    assert "No advice: single runs cannot distinguish a method from chance" in first_screen(
        tmp_path
    )


def test_equal_runs_do_not_differ(tmp_path: Path) -> None:
    for seed in range(3):
        first = fake_run(tmp_path, seed=seed)
        twin = shutil.copytree(first, tmp_path / "runs" / f"twin{seed}") / "record.json"
        content = json.loads(twin.read_text())
        content["config"]["augment"]["name"] = "safi"
        twin.write_text(json.dumps(content))
    text = first_screen(tmp_path)
    assert "- SAFI: 0.00 dB (95 % CI 0.00 to 0.00), not significant." in text


def test_text_and_bars_agree_on_a_committed_study(tmp_path: Path) -> None:
    """The five-scene ablation: UAR loses on these scenes, and nothing is shown for scenes like
    these."""
    write_committed(tmp_path / "study", "ablation_main")
    study = collect(tmp_path / "study")
    actual = outcomes(study)
    c = labelled(actual.comparisons)["none + uar"]
    assert (len(c.scenes), c.n) == (5, 5) and c.difference == pytest.approx(-0.10, abs=0.01)
    plot = forest_of(study, actual)
    filled = {row.method for row in plot.rows if row.significant and row.label == "these 5 scenes"}
    assert filled == {m.name for m, c in actual.comparisons.items() if c.significant}
    text = first_screen(tmp_path / "study")
    assert "**Use the baseline" in text and "UAR" in filled
    assert all(re.search(rf"- {re.escape(m)}: -.*, significant", text) for m in filled)
    assert "from the spread over these 5: no significant difference" in text
    thick = [row for row in plot.rows if row.joint]
    assert all(not (row.significant and row.low <= 0 <= row.high) for row in thick)  # type: ignore[operator]
    assert {row.label for row in plot.rows} >= {"embedded °", "dtu_scan65", "llff_fern °"}


@pytest.mark.parametrize(
    ("doses", "expected"),
    [
        (({"acted_share": 0.12},) * 2, "SAFI (12 % on embedded)"),
        (({"acted_share": 0.0}, {"acted_share": 0.9}), "SAFI (0 % on embedded in 1 of 2 runs)"),
        (  # the other part was tested; less than half does not read as half
            ({"acted_share": 0.497, "a_acted_share": 0.9, "{b}_acted_share": 0.497},),
            "SAFI, part {b} (49.7 % on embedded)",
        ),
    ],
)
def test_methods_that_hardly_acted_are_named(
    tmp_path: Path, doses: tuple[dict[str, float], ...], expected: str
) -> None:
    for seed, dose in enumerate(doses):
        path = fake_run(tmp_path, "safi", seed=seed) / "record.json"
        path.write_text(json.dumps(json.loads(path.read_text()) | {"dose": dose}))
    text = first_screen(tmp_path)
    assert f"less than half of their occasions: {expected}" in text


def test_warnings_reach_the_verdict_and_the_notes(tmp_path: Path) -> None:
    run = fake_run(tmp_path)
    fake_run(tmp_path, seed=1)
    content = json.loads((run / "record.json").read_text())
    content["warnings"] = ["scene=photos: 2 photos were placed by few points"]
    (run / "record.json").write_text(json.dumps(content))
    assert read_record(run / "record.json").warnings == tuple(content["warnings"])
    text = first_screen(tmp_path)
    assert "Caution: see the warnings about embedded below.**" in text
    assert "1 of 2 runs): scene=photos: 2 photos were placed by few points" in text
    content["provenance"][POSE_CHECK] = {"support": 0.2, "chance": 0.2, "ratio": 1.0, "fits": False}
    (run / "record.json").write_text(json.dumps(content))
    caution = "Caution: the poses do not seem to fit the photos of embedded.**"
    assert caution in first_screen(tmp_path)
    del content["warnings"]
    (run / "record.json").write_text(json.dumps(content))
    assert read_record(run / "record.json").warnings == ()


def test_scenes_that_chose_nothing_are_compared_alone_too(tmp_path: Path) -> None:
    for scene, gain in (("llff_fern", 3.0), ("llff_horns", -3.0)):
        write(tmp_path, {"none": 0.0, "safi": gain}, 4, scene=scene)
    text = first_screen(tmp_path)
    assert "On llff_horns alone, whose test photos had no part in choosing defaults: SAFI -" in text
    assert "llff_fern chose defaults of this project (marked °)" in text


# --- another baseline ---


@pytest.fixture
def study(tmp_path: Path) -> Path:
    for (augment, reg), gain in GAINS.items():
        for seed in range(3):
            fake_run(tmp_path / "study", augment, reg, seed, gain)
    return tmp_path / "study"


@pytest.mark.parametrize("name", ["uar", "UAR", "none + uar"])
def test_all_are_compared_with_the_method_that_was_named(study: Path, name: str) -> None:
    actual = outcomes(collect(study, rival=name))
    assert {c.baseline.label for c in actual.comparisons.values()} == {"none + uar"}
    psnr, gains = labelled(actual.psnr), labelled(actual.comparisons)
    base = psnr["none + uar"].mean
    assert {m: c.difference for m, c in gains.items()} == pytest.approx(
        {m: psnr[m].mean - base for m in ("none + none", "safi + none")}
    )
    text = first_screen(study, rival=name)
    assert "Chosen with `--baseline`: methods are compared with UAR." in text
    assert "**Use SAFI: it gains" in text and "compared with UAR on embedded" in text


def test_a_rival_that_nothing_beats_is_not_advised(study: Path) -> None:
    text = first_screen(study, rival="safi")
    assert "**No method is significantly better than SAFI on embedded.**" in text
    assert "Use " not in text


def test_runs_fail_by_plain_training_whoever_is_the_rival(tmp_path: Path) -> None:
    for (augment, reg), gain in {("none", "none"): 0.0, ("none", "uar"): -5.0}.items():
        for seed in range(3):
            fake_run(tmp_path, augment, reg, seed, gain)
    for rival in ("", "uar"):
        study = collect(tmp_path, rival=rival)
        rate = failure_rate(study, called(study, "none + uar"))
        assert rate is not None and rate.failed == 3


def test_budgets_are_compared_at_equal_budgets(tmp_path: Path) -> None:
    for (augment, reg), steps in product(GAINS, (100, 200)):
        if (reg, steps) != ("uar", 200):
            for seed in range(3):
                name = f"{augment}-{reg}-{steps}-{seed}"
                trainer = make_config()["trainer"] | {"steps": steps}
                fake_run(tmp_path, augment, reg, seed, run_name=name, trainer=trainer)
    study = collect(tmp_path, rival="uar")
    assert [m.label for m in study.families] == ["none + uar", "none + none", "safi + none"]
    bases = {c.method.label: c.baseline.label for c in outcomes(study).comparisons.values()}
    assert bases["safi + none, steps=100"] == "none + uar, steps=100"
    assert bases["safi + none, steps=200"] == "none + none, steps=200", "the rival lacks it"
    text = first_screen(tmp_path, rival="uar")
    assert "UAR, steps=100; with other budgets or options, with Baseline, steps=200." in text


def test_an_unknown_baseline_is_refused_with_those_there_are(study: Path) -> None:
    expected = "--baseline: expected a method of the report, got 'dba'; give one of none [+] none;"
    with pytest.raises(UserError, match=expected):
        build_report(study, rival="dba")


# --- nothing tested ---


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
    assert text.splitlines()[2].startswith("**Nothing was tested: no photo was held out")
    (header,) = (
        line for line in text.splitlines() if line.startswith("| Method") and "CPU" in line
    )
    assert "PSNR" not in header
    assert f"PSNR: missing in {3 * methods} of {3 * methods} runs: no test views" in text
    assert "protocol none" in text and "tested on none" in text
    headings = {line for line in text.splitlines() if line.startswith("## ")}
    assert headings == {"## Results", "## Diagnostics", "## Appendix"}
    assert {path.suffix for path in tmp_path.iterdir()} == {"", ".md", ".html", ".csv", ".jsonl"}


def test_untested_scenes_leave_the_comparison_of_the_others_alone(tmp_path: Path) -> None:
    for seed in range(3):
        for augment, gain in (("none", 0.0), ("safi", 2.0)):
            fake_run(tmp_path / "a", augment, "none", seed, gain, condition={"split": "llff"})
            name = f"all-{augment}-s{seed}"
            more = {"condition": ALL, "tested": False, "run_name": name}
            fake_run(tmp_path / "a", augment, "none", seed, gain, **more)  # type: ignore[arg-type]
            fake_run(tmp_path / "b", augment, "none", seed, gain, condition={"split": "llff"})
    config = make_config(seed=9, scene={"name": "embedded", **ALL})
    write_failed(tmp_path / "a" / "runs" / "x", config, ["seed=9"], "loss: diverged")
    mixed, tested = (find(collect(tmp_path / name)) for name in "ab")
    assert len(mixed.study.scenes) == 2 and len(mixed.study.tested) == 1
    (one,), (other,) = mixed.compared, tested.compared
    assert (one.these, one.tests) == (other.these, other.tests)
    assert "Not tested (scene.split=none), so not compared" in first_screen(tmp_path / "a")
