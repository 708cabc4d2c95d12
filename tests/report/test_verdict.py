"""The verdict: what it claims, what it does not, and what it tells of the study's power."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from framework.report.figures.forest import forest
from framework.report.figures.views import choose_views
from framework.report.statistics.compare import compare
from framework.report.statistics.outcomes import outcomes
from framework.report.study.collect import collect
from framework.report.text.dose import idle_sentence
from framework.report.verdict.lead import lead
from framework.report.verdict.points import evidence, points
from tests.record.fakes import fake_run
from tests.report.studies import write_committed


def told(folder: Path) -> tuple[str, str]:
    study = collect(folder)
    found = outcomes(study)
    return lead(study, found), "\n".join(points(study, found))


def test_a_winner_is_advised_with_its_gain(tmp_path: Path) -> None:
    for augment, reg, gain in (("none", "none", 0.0), ("safi", "uar", 2.0)):
        for seed in range(3):
            fake_run(tmp_path, augment, reg, seed, gain)
    first, rest = told(tmp_path)
    assert re.fullmatch(
        r"Use safi \+ uar: it gains \d\.\d+ dB \(\d\.\d+ to \d\.\d+\) against none \+ none \(plain"
        r" training\) on embedded\.",
        first,
    )
    assert "Really different from none + none: nobody else." in rest and "Not told" not in rest
    assert "Cost of a training: safi + uar 18.1 s" in rest and "none + none 16.1 s" in rest


def test_significant_losers_are_named_and_the_baseline_advised(tmp_path: Path) -> None:
    for augment, gain in (("none", 0.0), ("safi", -2.0), ("dba", 0.02), ("euclidean", -3.0)):
        for seed in range(4):
            fake_run(tmp_path, augment, seed=seed, gain=gain)
    first, rest = told(tmp_path)
    assert first == (
        "Use none + none (plain training) on embedded: nothing else was shown to be better."
    )
    assert re.match(
        r"Really different from none \+ none: euclidean \+ none costs \d.+\); safi \+ none costs"
        r" \d.+\)\.\n"
        r"Not told apart from none \+ none: dba \+ none \+0\.\d+ dB \(-\d.+\)\. A difference of"
        r" up to \d.+ dB could hide\.\nSteadier from seed to seed: nobody is shown to be\.",
        rest,
    )
    assert "Where none + none is weakest on embedded: its worst view is" in rest


def test_who_is_as_good_as_the_best_is_told(tmp_path: Path) -> None:
    for augment, gain in (("none", 0.0), ("safi", 2.0), ("dba", 2.0), ("euclidean", -1.0)):
        for seed in range(4):
            fake_run(tmp_path, augment, seed=seed, gain=gain)
    first, rest = told(tmp_path)
    best, other = ("safi", "dba") if first.startswith("Use safi") else ("dba", "safi")
    assert first.startswith(f"Use {best} + none: it gains")
    assert f"Not told apart from {best} + none: {other} + none" in rest


def test_power_is_told_where_nothing_is_steadier(tmp_path: Path) -> None:
    """With few seeds that is no test at all, and the line says so."""
    for seed in range(12):
        for augment in ("none", "safi"):
            fake_run(tmp_path, augment, seed=seed)
        if seed == 3:
            few = r"With 4 seeds that says next to nothing: .* below 0\.0\d+ times that of"
            assert re.search(few, told(tmp_path)[1])
    assert re.search(r"With 12 seeds a spread .* below 0\.\d+ times that of", told(tmp_path)[1])


def test_one_method_is_nothing_to_compare(tmp_path: Path) -> None:
    fake_run(tmp_path)
    assert "single run (n = 1), which says nothing about its stability" in told(tmp_path)[0]
    for seed in (1, 2):
        fake_run(tmp_path, seed=seed)
    first, rest = told(tmp_path)
    assert re.match(r"Nothing to compare: on embedded, none \+ none .*95 %, n = 3 seeds, σ", first)
    assert "Cost of a training: none + none" in rest


def test_single_runs_and_strangers_are_no_evidence(tmp_path: Path) -> None:
    fake_run(tmp_path, seed=0)
    fake_run(tmp_path, "safi", seed=1, gain=1.0)
    assert "none + none has no run of the same scene, seed and options" in told(tmp_path)[0]
    assert [run.seed for run in choose_views(collect(tmp_path), "embedded").runs] == [0, 1]
    fake_run(tmp_path, "safi", seed=0, gain=1.0)
    assert told(tmp_path)[0].startswith("No advice: single runs cannot tell a method from chance")


def test_equal_runs_are_not_told_apart(tmp_path: Path) -> None:
    for seed in range(3):
        first = fake_run(tmp_path, seed=seed)
        twin = shutil.copytree(first, tmp_path / "runs" / f"twin{seed}") / "record.json"
        content = json.loads(twin.read_text())
        content["config"]["augment"]["name"] = "safi"
        twin.write_text(json.dumps(content))
    rest = told(tmp_path)[1]
    assert "Not told apart from none + none: safi + none 0.00 dB (0.00 to 0.00)." in rest
    assert "could hide" not in rest


def test_text_and_bars_agree_on_a_committed_study(tmp_path: Path) -> None:
    """The five-scene ablation, from its table of runs: UAR loses on these scenes, and nothing is
    shown for scenes like these."""
    write_committed(tmp_path, "ablation_main")
    study = collect(tmp_path)
    found = outcomes(study)
    c = found.comparisons["none + uar"]
    assert (len(c.scenes), c.n) == (5, 5) and c.difference == pytest.approx(-0.10, abs=0.01)
    drawn = forest(study, found)
    assert drawn is not None
    real = {row.method for row in drawn[0].rows if row.real and row.label == "these 5 scenes"}
    assert real == {m for m, c in found.comparisons.items() if c.significant}
    first, rest = told(tmp_path)
    assert first.startswith("Use none + none (plain training)")
    assert all(f"{method} costs" in rest for method in real) and "none + uar" in real
    assert "judged by how these 5 differ: no difference is shown" in rest
    thick = [row for row in drawn[0].rows if row.joint]
    assert all(not (row.real and row.low <= 0 <= row.high) for row in thick)  # type: ignore[operator]
    assert {row.label for row in drawn[0].rows} >= {"embedded °", "dtu_scan65", "llff_fern °"}


def test_a_method_that_hardly_acted_is_told(tmp_path: Path) -> None:
    for augment, share in (("none", None), ("safi", 0.12)):
        for seed in range(3):
            path = fake_run(tmp_path, augment, seed=seed) / "record.json"
            if share is not None:
                content = json.loads(path.read_text())
                path.write_text(json.dumps(content | {"dose": {"acted_share": share}}))
    assert idle_sentence(collect(tmp_path)).startswith(
        "Hardly tested, for it acted on less than half of its occasions: safi + none (12 % on"
    )


def test_a_seed_in_which_a_method_hardly_acted_is_told_too(tmp_path: Path) -> None:
    for seed, share in enumerate((0.0, 1.0, 0.9)):
        path = fake_run(tmp_path, "safi", seed=seed) / "record.json"
        content = json.loads(path.read_text())
        path.write_text(json.dumps(content | {"dose": {"acted_share": share}}))
    told = idle_sentence(collect(tmp_path))
    assert told.startswith("In some runs it acted on less than half of its occasions: safi + none")
    assert told.endswith("(0 % on embedded in 1 of 3 runs).") and "Hardly" not in told


def test_a_part_that_hardly_acted_is_told_by_its_name(tmp_path: Path) -> None:
    """What the other part did was tested; less than half is not told as half."""
    parts = {"frequency_acted_share": 0.9, "occlusion_acted_share": 0.497}
    for seed in range(2):
        path = fake_run(tmp_path, "safi", seed=seed) / "record.json"
        content = json.loads(path.read_text())
        dose = {"dose": {"acted_share": min(parts.values()), **parts}}
        path.write_text(json.dumps(content | dose))
    assert idle_sentence(collect(tmp_path)) == (
        "A part that acted on less than half of its occasions was hardly tested: safi + none"
        " (occlusion: 49.7 % on embedded)."
    )


def test_scenes_with_one_share_are_told_together(tmp_path: Path) -> None:
    shares = {"dtu_scan24": 0.1, "llff_fern": 0.1, "llff_room": 0.3}
    for scene, share in shares.items():
        path = fake_run(tmp_path, "safi", scene=scene) / "record.json"
        content = json.loads(path.read_text())
        path.write_text(json.dumps(content | {"dose": {"acted_share": share}}))
    told = idle_sentence(collect(tmp_path))
    assert "safi + none (10 % on dtu_scan24 and llff_fern, 30 % on llff_room)" in told


@pytest.mark.parametrize(
    ("shares", "expected"),
    [
        (({"{a}": 0.1, "b": 0.9},), "safi + none ({a}: 10 % on embedded)"),  # as somebody named it
        (({"a": 0.4, "b": 0.9}, {"a": 0.7, "b": 0.45}), "safi + none (43 % on embedded in 2 of 2"),
    ],
)
def test_who_hardly_acted_is_never_left_out(
    tmp_path: Path, shares: tuple[dict[str, float], ...], expected: str
) -> None:
    """Also where each part acted enough over the runs, and in none of them both."""
    for seed, parts in enumerate(shares):
        path = fake_run(tmp_path, "safi", seed=seed) / "record.json"
        content = json.loads(path.read_text())
        told = {f"{part}_acted_share": share for part, share in parts.items()}
        dose = {"acted_share": min(parts.values()), **told}
        path.write_text(json.dumps(content | {"dose": dose}))
    assert expected in idle_sentence(collect(tmp_path))


def test_a_single_run_has_no_worst_seed(tmp_path: Path) -> None:
    """Nor is there a rate of failures of one."""
    fake_run(tmp_path)
    alone = told(tmp_path)[1]
    assert "its worst view is" in alone and "worst seed" not in alone and "failed" not in alone
    fake_run(tmp_path, seed=1)
    both = told(tmp_path)[1]
    assert "its worst seed" in both and "0 of 2 runs failed" in both


def test_how_names_are_read_is_told_of_pairs_alone() -> None:
    """Recipes have names of their own."""
    base = {("fern", seed): 1.0 * seed for seed in range(3)}
    c = compare("a", {key: 1.1 * value for key, value in base.items()}, "b", base)
    assert c is not None
    for method, start in (("corgs_here", "differences are"), ("none + uar", "a method is named")):
        found: Any = SimpleNamespace(comparisons={method: replace(c, method=method)})
        assert evidence(found).startswith(f"How to read this: {start}")
