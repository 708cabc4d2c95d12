"""What a report advises where runs differ in more than the method, and where pairs are missing."""

from __future__ import annotations

import csv
import re
from pathlib import Path

from framework.report import build_report
from framework.report.costs import choices, entries, paying, train_s
from framework.report.findings import contests
from framework.report.statistics.compare import block
from framework.report.statistics.outcomes import outcomes
from framework.report.study.collect import collect
from tests.record.fakes import fake_run
from tests.report.studies import Row, first_screen, labelled, row, table

LEVELS = (18.0, 18.1, 18.2, 22.0, 22.1)  # of seeds, of which one method may lack the best


def study(means: dict[str, float], seeds: int = 5) -> list[Row]:
    return [row("fern", method, k, mean) for k in range(seeds) for method, mean in means.items()]


def test_what_gains_on_a_bad_start_is_not_advised_over_a_good_one(tmp_path: Path) -> None:
    means = {"none + none": 25.0, "safi + none": 25.0}
    means |= {"none + none, init=sparse": 20.0, "safi + none, init=sparse": 22.0}
    text = first_screen(table(tmp_path / "t", study(means)))
    assert "**Use the baseline on fern: no method is significantly better than it" in text
    assert re.search(r"SAFI, init=sparse: \+2\.\S+ dB \(.*\) compared with Baseline, init", text)


def test_a_variant_of_plain_training_that_is_better_is_advised(tmp_path: Path) -> None:
    means = {"none + none": 20.0, "safi + none": 21.0}
    means |= {"none + none, init=rich": 25.0, "safi + none, init=rich": 25.0}
    text = first_screen(table(tmp_path / "t", study(means)))
    assert "**Use Baseline, init=rich: it gains 5.0" in text


def test_what_is_better_than_one_plain_training_alone_is_told(tmp_path: Path) -> None:
    rows = study({"none + none": 20.0, "safi + none": 21.0})
    for method in ("none + none, init=rich", "safi + none, init=rich"):
        rows += [row("fern", method, k, 20.5 + 3 * (k - 2)) for k in range(5)]
    text = first_screen(table(tmp_path / "t", rows))
    assert "fern: SAFI is significantly better than it, but not better than every baseline" in text


def test_a_method_without_runs_on_every_scene_is_told_as_such(tmp_path: Path) -> None:
    rows = [row(s, "none + none", k, 20.0) for s in "ab" for k in range(4)]
    rows += [row("a", "safi + none", k, 21.0) for k in range(4)]
    rows += [row(s, "dba + none", k, 20.0) for s in "ab" for k in range(4)]
    text = first_screen(table(tmp_path / "t", rows))
    assert "SAFI is significantly better where compared, but did not run on all scenes" in text


def test_what_is_advised_over_the_baseline_is_not_told_as_alike(tmp_path: Path) -> None:
    """With a third method, which shares no seed with the baseline, its test is of two, not one."""
    values = {
        "none + none": (20.0, 20.03),
        "none + uar": (20.2, 20.21),
        "safi + none": (20.2, 20.2),
    }
    seeds = {"none + none": (2, 3), "none + uar": (2, 3, 10, 11), "safi + none": (10, 11)}
    rows = [row("a", m, k, f"{values[m][k % 2]}") for m, ours in seeds.items() for k in ours]
    text = first_screen(table(tmp_path / "t", rows))
    assert "**Use UAR: it gains" in text
    alike = re.search(r"Not significantly different from UAR: ([^\n]*)", text)
    assert alike is not None and "SAFI" in alike[1] and "Baseline" not in alike[1]


def test_a_metric_that_some_seeds_lack_says_of_how_many_it_is(tmp_path: Path) -> None:
    rows = [
        row("a", m, k, 20.0, lpips=0.1 * k if m == "none + none" or k > 1 else "")
        for m in ("none + none", "safi + none")
        for k in range(4)
    ]
    text = build_report(table(tmp_path / "t", rows), out_dir=tmp_path / "out").read_text("utf-8")
    cells = re.findall(r"0\.\d+ \(n = 2\)", text)
    assert cells == ["0.25 (n = 2)"], (
        "of seeds 2 and 3; of all four of plain training there is no n"
    )


def test_more_time_pays_is_corrected_for_all_others(tmp_path: Path) -> None:
    """The data choose who is on the front, so being alone there is no single test."""
    gains = (0.08, 0.28, 0.06, 0.2, 0.15)
    fast = [row("a", "none + none", k, 20.0, train_wall_s=5, train_cpu_s=5) for k in range(5)]
    slow = [row("a", "safi + none", k, 20.0 + gain) for k, gain in enumerate(gains)]
    worse = [row("a", f"none + none, trainer.x={i}", k, 19.0) for i in range(9) for k in range(5)]
    for others, indices in (([], [0, 1]), (worse, [0])):
        actual = entries(collect(table(tmp_path / f"{len(others)}", fast + slow + others)), "a")
        kept = paying(actual, train_s)
        assert [actual[k].method.label for k in kept] == ["none + none", "safi + none"][
            : len(indices)
        ]


def test_advice_by_time_is_by_pairs(tmp_path: Path) -> None:
    """A method that lacks the easy seeds is no worse for it: the advice is that of the verdict."""
    slow = [row("a", "none + none", k, v, train_cpu_s=12) for k, v in enumerate(LEVELS)]
    fast = [row("a", "safi + none", k, LEVELS[k] + 0.5) for k in range(3)]
    study = collect(table(tmp_path / "t", slow + fast))
    assert "**Use SAFI: it gains 0.5" in first_screen(tmp_path / "t")
    (choice,) = choices(study, "a")
    assert choice.entry is not None and str(choice.entry.method) == "SAFI"


def test_more_time_pays_by_pairs(tmp_path: Path) -> None:
    """Not if the pairs show that it is worse, and so if only they show that it is
    better."""
    full = [row("a", "none + none", k, v) for k, v in enumerate(LEVELS)]
    for seconds, kept in ((5, ["safi + none"]), (20, ["none + none", "safi + none"])):
        part = [
            row("a", "safi + none", k, LEVELS[k] + 0.5, train_wall_s=seconds, train_cpu_s=seconds)
            for k in range(3)
        ]
        actual = entries(collect(table(tmp_path / f"{seconds}", full + part)), "a")
        assert [actual[k].method.label for k in paying(actual, train_s)] == kept


def test_a_baseline_without_a_seed_on_all_scenes_is_no_crash(tmp_path: Path) -> None:
    rows = [row("a", "none + none", 0, 20.0), row("b", "none + none", 1, 20.0)]
    for extra in ("", ", init=rich"):
        rows += [row(s, f"safi + none{extra}", k, 21.0) for s in "ab" for k in range(3)]
    rows += [row(s, "none + none, init=rich", k, 20.0) for s in "ab" for k in range(3)]
    assert first_screen(table(tmp_path / "t", rows)).startswith("# t_report")


def test_what_gains_with_few_steps_is_not_advised_over_many(tmp_path: Path) -> None:
    means = {"none + none, steps=300": 20.0, "safi + none, steps=300": 21.0}
    means |= {"none + none, steps=3000": 25.0, "safi + none, steps=3000": 24.0}
    rows = [one | {"trainer.steps": int(str(one["method"])[-3:]) or 3000} for one in study(means)]
    actual = outcomes(collect(table(tmp_path, rows)))
    assert labelled(actual.comparisons)["safi + none, steps=300"].significant
    assert actual.best.label == "none + none, steps=300", (
        "the first of its budgets represents the family"
    )


def test_the_best_is_chosen_by_pairs(tmp_path: Path) -> None:
    """Seeds 3 to 9 lie lower: a method that has them alone is not worse for it."""
    low = [row("fern", m, k, v - 1) for k in range(3, 10) for m, v in (("none + none", 20.0),)]
    low += [row("fern", "dba + none", k, 19.2) for k in range(3, 10)]
    means = {"none + none": 20.0, "safi + none": 20.1, "dba + none": 20.2}
    actual = outcomes(collect(table(tmp_path, [*study(means, 3), *low])))
    psnr = labelled(actual.psnr)
    assert psnr["dba + none"].mean < psnr["safi + none"].mean
    assert actual.best.label == "dba + none"


def test_pairs_that_lack_none_are_kept() -> None:
    every = {("a", 0), ("a", 1), ("b", 0), ("b", 1), ("b", 2)}
    assert block(every) == (["a", "b"], [0, 1])
    assert block({*every, ("c", 2)}) == (["a", "b"], [0, 1])
    assert block({("a", 0), ("b", 1)}) == (["a", "b"], [])
    assert block({("a", 0), ("b", 0), ("b", 1), ("b", 2)}) == (["b"], [0, 1, 2])


def test_a_scene_with_one_seed_does_not_take_the_others_away(tmp_path: Path) -> None:
    means = {"none + none": 20.0, "safi + none": 21.0}
    rows = [row(s, m, k, v) for s in "abc" for k in range(4) for m, v in means.items()]
    rows += [row("d", m, 0, v) for m, v in means.items()]
    text = first_screen(table(tmp_path / "t", rows))
    assert re.search(r"\*\*Use SAFI: it gains 1.* on 3 of these 4 scenes\.\*\*", text)


def test_intervals_say_how_many_comparisons_they_hold_for(tmp_path: Path) -> None:
    """One that only several scenes can test counts too."""
    rows = [
        row(s, m, k, 20.0) for s in "abc" for k in range(3) for m in ("none + none", "dba + none")
    ]
    rows += [row(s, "safi + none", 0, 20.0 + len(s)) for s in "abc"]
    text = build_report(table(tmp_path / "t", rows), out_dir=tmp_path / "out").read_text("utf-8")
    assert "corrected for all 2 comparisons at once" in text


def test_single_seeds_on_many_scenes_are_corrected_for_all_methods(tmp_path: Path) -> None:
    means = {"none + none": 20.0, "safi + none": 20.3, "dba + none": 20.2}
    rows = [row(s, m, 0, v + len(s) / 9) for s in ("a", "bb", "ccc") for m, v in means.items()]
    actual = outcomes(collect(table(tmp_path, rows))).comparisons
    assert {c.tests for c in actual.values()} == {2} and labelled(actual)["safi + none"].p is None


def test_a_stress_on_one_scene_hides_no_other(tmp_path: Path) -> None:
    for seed in range(3):
        for augment in ("none", "safi"):
            for views in (2, 3, 4):
                condition = {"n_views": views}
                fake_run(tmp_path, augment, seed=seed, scene="fox", condition=condition,
                         run_name=f"{augment}{views}-{seed}")  # fmt: skip
            fake_run(tmp_path, augment, seed=seed, gain=3.0 * (augment == "safi"), scene="fern")
    text = build_report(tmp_path).read_text(encoding="utf-8")
    assert "## Comparisons" in text
    assert "on these 4 conditions of 2 scenes" in text.split("\n\n")[1]


def test_a_stress_with_one_seed_at_one_strength_keeps_the_others(tmp_path: Path) -> None:
    for views, seeds in ((2, 1), (3, 4), (4, 4)):
        for seed in range(seeds):
            for augment in ("none", "safi"):
                gain, name = 2.0 * (augment == "safi"), f"{augment}{views}-{seed}"
                condition = {"n_views": views}
                fake_run(tmp_path, augment, "none", seed, gain, condition=condition, run_name=name)
    text = build_report(tmp_path).read_text(encoding="utf-8")
    assert text.split("\n\n")[1].startswith("**Use SAFI where it helps")
    assert "SAFI helps at 4 and 3 training views (" in text


def test_a_method_without_a_psnr_anywhere_is_no_crash(tmp_path: Path) -> None:
    rows = study({"none + none": 20.0, "safi + none": 21.0})
    rows[3]["psnr"] = ""
    text = first_screen(table(tmp_path / "t", rows))
    assert text.startswith("# t_report\n\n**")


def test_no_advice_by_time_across_machines(tmp_path: Path) -> None:
    rows = study({"none + none": 20.0, "safi + none": 21.0})
    fast = [
        one | {"cpu": f"{'new' if one['method'] == 'safi + none' else 'old'}, 2 cores"}
        for one in rows
    ]
    text = build_report(table(tmp_path / "t", fast), out_dir=tmp_path / "out").read_text("utf-8")
    assert "made on different machines (old, 2 cores: 5 runs of Baseline; new" in text
    assert "Within 15" not in text
    same = [one | {"cpu": "old, 2 cores"} for one in rows]
    text = build_report(table(tmp_path / "s", same), out_dir=tmp_path / "out2").read_text("utf-8")
    assert "Within 15" in text and "different machines" not in text


def test_sizes_that_are_no_ratio(tmp_path: Path) -> None:
    rows = study({"none + none": 20.0, "none + none, capacity=evidence": 21.0})
    rows = [
        one | {"capacity.name": "evidence" if "=" in str(one["method"]) else "fixed"}
        for one in rows
    ]
    none = [
        one | ({"gaussians": 0, "parameters": 0} if "=" not in str(one["method"]) else {})
        for one in rows
    ]
    actual = contests(collect(table(tmp_path, none)))
    assert [contest.parameters for contest in actual] == [None]


def test_all_views_are_counted_in_a_table(tmp_path: Path) -> None:
    for views in (2, "all"):
        fake_run(tmp_path, condition={"n_views": views}, run_name=f"v{views}")
    report = build_report(tmp_path)
    with (report.parent / "runs.csv").open(encoding="utf-8") as file:
        assert sorted(one["scene.n_views"] for one in csv.DictReader(file)) == ["1", "2"]
