"""The verdict: what it claims, what it does not, and what it says about the study's power."""

import json
import re
from pathlib import Path

import pytest

from framework.records.record import POSE_CHECK, read_record
from framework.report import build_report
from framework.report.figures.views import choose_views
from framework.report.statistics.outcomes import outcomes
from framework.report.study.collect import collect
from tests.record.fakes import fake_run
from tests.report.studies import first_screen, labelled, row, table

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
    assert ", not significant" not in text and "share one draw" not in text
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


def test_one_method_is_nothing_to_compare_and_the_baseline_is_a_command(tmp_path: Path) -> None:
    mine = tmp_path / "reports" / "mine"
    fake_run(mine, "safi", "uar")
    assert "in a single run (n = 1), whose variation is unknown" in first_screen(mine)
    for seed in (1, 2):
        fake_run(mine, "safi", "uar", seed=seed)
    text = first_screen(mine)
    assert re.search(r"Nothing to compare: on embedded, SAFI \+ UAR reaches .*n = 3 seeds, σ", text)
    assert "`fishersplat method=baseline seed=0,1,2 study=mine -m`" in text
    assert "Cost of a training: SAFI + UAR" in text
    fake_run(tmp_path / "plain")
    assert "method=baseline" not in first_screen(tmp_path / "plain")


def test_a_method_that_lacks_seeds_on_a_scene_is_not_advised(tmp_path: Path) -> None:
    gains = {"a": 1.0, "b": 1.0, "c": -5.0}
    rows = [
        row(scene, method, seed, 20 + (gain if method == "safi + none" else 0))
        for scene, gain in gains.items()
        for method in ("none + none", "safi + none")
        for seed in (range(3) if scene != "c" else [0])
    ]
    text = first_screen(table(tmp_path / "study", rows))
    assert "significantly better where compared, but lacks scenes or seeds.**" in text


def test_a_baseline_that_lacks_a_scene_is_not_advised(tmp_path: Path) -> None:
    rows = [row(scene, "safi + none", seed, 20) for scene in "ab" for seed in (0, 1)]
    rows += [row("a", "none + none", seed, 20) for seed in (0, 1)]
    text = first_screen(table(tmp_path / "study", rows))
    assert "**No advice: the baseline lacks scenes or seeds." in text


def test_advice_by_time_names_budgets_of_the_advised_method(tmp_path: Path) -> None:
    rows = [row("a", "none + none, steps=20", seed, 20, train_cpu_s=5) for seed in (0, 1)]
    for steps, psnr in {20: 19, 40: 30}.items():
        rows += [row("a", f"safi + none, steps={steps}", seed, psnr) for seed in (0, 1)]
    verdict = first_screen(table(tmp_path / "study", rows)).splitlines()[2]
    assert "Use the baseline" in verdict and "SAFI, steps" not in verdict


def test_without_a_baseline_the_first_method_is_not_advised(tmp_path: Path) -> None:
    write(tmp_path / "study", {"full_set": 0.0, "safi": 0.01}, 2)
    text = first_screen(tmp_path / "study")
    assert "**No method is significantly better than Full set on embedded. To add the" in text


def test_runs_without_a_psnr_are_counted(tmp_path: Path) -> None:
    rows = [
        row("a", method, seed, "" if seed > 2 and gain else 20 + gain)
        for method, gain in {"none + none": 0, "safi + none": 1}.items()
        for seed in range(5)
    ]
    text = first_screen(table(tmp_path / "study", rows))
    assert "Caution: 2 of 5 runs of SAFI have no finite PSNR.**" in text
    assert "2 of 5 runs of SAFI have no finite PSNR, so they are in no mean" in text


def test_a_result_of_one_seed_is_not_marked_but_counts(tmp_path: Path) -> None:
    rows = [row("a", "none + none", seed, 20) for seed in range(3)]
    rows += [row("a", "dba + none", seed, 21) for seed in range(3)]
    rows += [row("a", "safi + none", 0, 22)]
    page = build_report(table(tmp_path / "study", rows)).path.read_text(encoding="utf-8")
    cells = [line.split("|")[2].strip() for line in page.splitlines() if line.startswith("| ")][1:]
    assert cells[1].startswith("<u>21.0") and cells[2].startswith("2")
    assert cells[2].endswith("(n = 1)")


def test_single_runs_and_strangers_are_no_evidence(tmp_path: Path) -> None:
    fake_run(tmp_path, seed=0)
    fake_run(tmp_path, "safi", seed=1, gain=1.0)
    assert "no method shares a scene, a seed and options with the baseline" in first_screen(
        tmp_path
    )
    assert [run.seed for run in choose_views(collect(tmp_path), "embedded")[0]] == [0, 1]
    fake_run(tmp_path, "safi", seed=0, gain=1.0)
    assert "No advice: single runs cannot distinguish a method from chance" in first_screen(
        tmp_path
    )


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


def test_warnings_that_differ_in_numbers_alone_are_one(tmp_path: Path) -> None:
    for seed, epochs in enumerate((12, 9, 10)):
        run = fake_run(tmp_path, seed=seed)
        content = json.loads((run / "record.json").read_text())
        content["warnings"] = [f"augment=safi: made a pseudo view in only {epochs} of 20 epochs"]
        (run / "record.json").write_text(json.dumps(content))
    merged = "augment=safi: made a pseudo view in only 9 to 12 of 20 epochs"
    assert merged in first_screen(tmp_path)


# --- another baseline ---


@pytest.fixture
def study(tmp_path: Path) -> Path:
    for (augment, reg), gain in GAINS.items():
        for seed in range(3):
            fake_run(tmp_path / "study", augment, reg, seed, gain)
    return tmp_path / "study"


def test_all_are_compared_with_the_method_that_was_named(study: Path) -> None:
    actual = outcomes(collect(study, rival="UAR"))
    assert {c.baseline.label for c in actual.comparisons.values()} == {"none + uar"}
    psnr, gains = labelled(actual.psnr), labelled(actual.comparisons)
    base = psnr["none + uar"].mean
    assert {m: c.difference for m, c in gains.items()} == pytest.approx(
        {m: psnr[m].mean - base for m in ("none + none", "safi + none")}
    )
    text = first_screen(study, rival="UAR")
    assert "Chosen with `--baseline`: methods are compared with UAR." in text
    assert "**Use SAFI: it gains" in text and "compared with UAR on embedded" in text


# --- nothing tested ---


@pytest.mark.parametrize("methods", [1, 2])
def test_the_first_screen_says_that_nothing_was_tested(tmp_path: Path, methods: int) -> None:
    for augment, reg in (("none", "none"), ("safi", "uar"))[:methods]:
        for seed in range(3):
            fake_run(tmp_path, augment, reg, seed, condition=ALL, tested=False)
    text = build_report(tmp_path).path.read_text(encoding="utf-8")
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
