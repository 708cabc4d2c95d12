"""What a method gains with other photos of a scene, and whether draws of them differ."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from framework.report import build_report
from framework.report.statistics.drawn import draws, variance
from framework.report.study.collect import collect
from tests.record.fakes import fake_run
from tests.report.studies import first_screen, row, table

GAINS = {2: 1.0, 10: -1.0, 0: 0.5}  # of uar, by draw


def write_draws(folder: Path, gains: dict[int, float], seeds: int, scene: str = "fern") -> None:
    for draw, gain in gains.items():
        condition = {"split": f"llff_drawn{draw}"}
        for seed in range(seeds):
            for reg, ours in (("none", 0.0), ("uar", gain)):
                name = f"{scene}{draw}{reg}{seed}"
                fake_run(
                    folder, "none", reg, seed, ours, scene=scene, run_name=name, condition=condition
                )


def test_the_analysis_of_variance_is_scipy_s() -> None:
    rng = np.random.default_rng(0)
    groups = [list(rng.normal(0.3 * i, 1, size)) for i, size in enumerate((3, 5, 2, 4))]
    actual, reference = variance(groups), stats.f_oneway(*groups)
    assert actual is not None and (actual.between, actual.within) == (3, 10)
    assert actual.f == pytest.approx(reference.statistic) and actual.p == pytest.approx(
        reference.pvalue
    )
    inside = np.concatenate([np.subtract(g, np.mean(g)) for g in groups])
    assert actual.sd == pytest.approx(np.sqrt((inside**2).sum() / 10))
    assert variance(groups[:1]) is None
    flat = variance([[1.0, 1.0], [2.0, 2.0]])
    assert flat is not None and flat.p is None


def test_gains_by_draw_and_over_them(tmp_path: Path) -> None:
    write_draws(tmp_path, GAINS, seeds=3)
    for reg in ("none", "uar"):  # the papers' photos are no draw
        fake_run(tmp_path, "none", reg, 0, 9.0, scene="fern", condition={"split": "llff"})
    study = collect(tmp_path)
    (actual,) = draws(study)
    assert (actual.scene, str(actual.method), str(actual.baseline)) == ("fern", "UAR", "Baseline")
    assert list(actual.differences) == ["llff_drawn0", "llff_drawn2", "llff_drawn10"]
    ours = np.array(actual.gains)
    assert ours - ours.mean() == pytest.approx([0.5 - 1 / 6, 1 - 1 / 6, -1 - 1 / 6], abs=0.15)
    interval = actual.over.interval()
    assert interval is not None
    reference = stats.t.interval(0.95, 2, ours.mean(), stats.sem(ours))
    assert (interval.low, interval.high) == pytest.approx(reference)
    assert actual.alike is not None and actual.alike.p is not None
    assert actual.alike.p == pytest.approx(stats.f_oneway(*actual.differences.values()).pvalue)


def test_the_report_says_whether_a_gain_depends_on_the_photos(tmp_path: Path) -> None:
    write_draws(tmp_path, GAINS, seeds=3)
    text = build_report(tmp_path).read_text(encoding="utf-8")
    assert "- Significant effects of the choice of training photos: UAR on fern -" in text
    row = text.partition("### With other photos")[2].partition("| fern")[2].partition("\n")[0]
    cells = [cell.strip() for cell in row.split("|")]
    assert cells[3].count(",") == 2 and cells[-2].startswith("p ")


def test_equal_draws_are_not_told_apart(tmp_path: Path) -> None:
    write_draws(tmp_path, dict.fromkeys(range(3), 0.5), seeds=3)
    assert "no gain depends significantly on which were drawn" in first_screen(tmp_path)


def test_one_seed_cannot_tell(tmp_path: Path) -> None:
    write_draws(tmp_path, GAINS, seeds=1)
    study = collect(tmp_path)
    (actual,) = draws(study)
    assert actual.alike is None and len(actual.gains) == 3
    assert "With other photos" not in first_screen(tmp_path)


def test_draws_of_other_options_are_apart(tmp_path: Path) -> None:
    for views, draw in ((3, 0), (6, 0), (6, 1)):
        for reg in ("none", "uar"):
            condition = {"split": f"llff_drawn{draw}", "n_views": views}
            name = f"{views}{draw}{reg}"
            fake_run(tmp_path, "none", reg, scene="fern", run_name=name, condition=condition)
    (actual,) = draws(collect(tmp_path))
    assert len(actual.gains) == 2


def test_draws_with_another_depth_error_are_apart(tmp_path: Path) -> None:
    """What helps with plain depth costs with noise, on every draw."""
    rows = [
        row(f"fern (corruption={name}, split=llff_drawn{draw})", method, seed, 20.0 + ours,
            **{"scene.split": f"llff_drawn{draw}", "depth.corruption": name})
        for name, gain in (("none", 1.0), ("noise", -1.0))
        for draw in range(3)
        for method, ours in (("none + none", 0.0), ("safi + none", gain))
        for seed in range(2)
    ]  # fmt: skip
    actual = {ours.scene: ours for ours in draws(collect(table(tmp_path, rows)))}
    assert list(actual) == ["fern (corruption=noise)", "fern (corruption=none)"]
    means = [round(ours.over.mean) for ours in actual.values()]
    assert means == [-1, 1] and all(len(ours.gains) == 3 for ours in actual.values())


def test_other_studies_have_no_such_part(tmp_path: Path) -> None:
    for reg in ("none", "uar"):
        fake_run(tmp_path, "none", reg)
    assert not draws(collect(tmp_path))
