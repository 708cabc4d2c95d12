"""What a report advises where runs differ in more than the method, and where pairs are missing."""

import re
from pathlib import Path

from framework.report import build_report
from framework.report.costs import cheapest, entries, paying, train_s
from framework.report.statistics.outcomes import outcomes
from framework.report.study.collect import collect
from tests.report.studies import Row, first_screen, labelled, row, table


def study(means: dict[str, float], seeds: int = 5) -> list[Row]:
    return [row("fern", method, k, mean) for k in range(seeds) for method, mean in means.items()]


def test_what_gains_on_a_bad_start_is_not_advised_over_a_good_one(tmp_path: Path) -> None:
    means = {"none + none": 25.0, "safi + none": 25.0}
    means |= {"none + none, init=sparse": 20.0, "safi + none, init=sparse": 22.0}
    text = first_screen(table(tmp_path / "t", study(means)))
    assert "**Use the baseline on fern: no method is significantly better than it" in text
    assert re.search(r"SAFI, init=sparse: \+2\.\S+ dB \(.*\) compared with Baseline, init", text)


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


def test_the_smallest_file_and_the_least_time_that_are_as_good_are_named(tmp_path: Path) -> None:
    """Half the file costs 0.05 dB, a tenth costs 2 dB; the baseline takes the least time."""
    jitter = (0.1, -0.1, 0.0, 0.1, -0.1)  # so that a twentieth dB is no significant difference
    rows = [
        row(
            "a",
            method,
            k,
            f"{psnr + (jitter[k] if 'safi' in method else 0)}",
            ply_bytes=size,
            train_wall_s=seconds,
            train_cpu_s=seconds,
        )
        for k in range(5)
        for method, psnr, size, seconds in (
            ("none + none", 20.0, 10_000_000, 5),
            ("safi + none", 20.05, 10_000_000, 20),
            ("dba + none", 20.0, 5_000_000, 20),
            ("none + uar", 18.0, 1_000_000, 1),
        )
    ]
    study = collect(table(tmp_path / "t", rows))
    result = cheapest(study, "a")
    assert result is not None and result.smallest is not None and result.quickest is not None
    assert result.best.method.label == "safi + none"
    assert result.smallest.method.label == "dba + none"
    assert result.quickest.method.label == "none + none"
    text = build_report(tmp_path / "t", out_dir=tmp_path / "out").path.read_text(encoding="utf-8")
    assert re.search(r"DBA has the smallest file .*5\.00 MB", text)
    assert re.search(r"Baseline takes the least time .*5\.0 s", text)


def test_the_best_is_chosen_by_pairs(tmp_path: Path) -> None:
    """Seeds 3 to 9 lie lower: a method that has them alone is not worse for it."""
    low = [row("fern", m, k, v - 1) for k in range(3, 10) for m, v in (("none + none", 20.0),)]
    low += [row("fern", "dba + none", k, 19.2) for k in range(3, 10)]
    means = {"none + none": 20.0, "safi + none": 20.1, "dba + none": 20.2}
    actual = outcomes(collect(table(tmp_path, [*study(means, 3), *low])))
    psnr = labelled(actual.psnr)
    assert psnr["dba + none"].mean < psnr["safi + none"].mean
    assert actual.best.label == "dba + none"
