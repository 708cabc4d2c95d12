"""Forest plot, axes, close-ups, and the same figures as numbers and as LaTeX."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from framework.report import build_report
from framework.report.figures import pictures
from framework.report.figures.chart import Chart, Point, Series, draw
from framework.report.figures.charts import cost_charts
from framework.report.figures.forest import Forest, Row, limits
from framework.report.figures.forest import draw as draw_forest
from framework.report.figures.pictures import BESIDE, _window, draw_closeup
from framework.report.statistics.numbers import format_difference
from framework.report.stress import panels
from framework.report.study.collect import collect
from tests.record import fakes
from tests.record.fakes import fake_run


@pytest.fixture(scope="module")
def study_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("figures")
    for scene in ("embedded", "my_50%_{room}"):
        for augment, gain in (("none", 0.0), ("safi", 2.0)):
            for seed in range(3):
                fake_run(folder, augment, seed=seed, gain=gain, scene=scene)
    build_report(folder)
    return folder


def test_every_method_stands_above_its_crop_and_its_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With more methods than fit next to the ground truth, too."""
    methods = ("none", "dba", "euclidean", "full_set", "safi", "mvs_warp")[: BESIDE + 1]
    for augment in methods:
        fake_run(tmp_path, augment, seed=0)
    drawn: list[Any] = []
    draw_band = pictures.draw_band
    monkeypatch.setattr(pictures, "draw_band", lambda b: drawn.append(b) or draw_band(b))
    (scene,) = (study := collect(tmp_path)).scenes
    assert draw_closeup(study, scene) is not None
    (band,) = drawn
    sizes = [len(row) for row in band.groups]
    assert sizes == [BESIDE + 1] * 3 + [2] * 3
    names = [cell.title.split("\n")[0] for row in band.groups[::3] for cell in row[1:]]
    assert len(set(names)) == len(methods) and band.groups[3][0].title == "ground truth"


def row(low: float, high: float, joint: bool) -> Row:
    return Row("m", "label", 0, (low + high) / 2, low, high, joint, False)


def test_the_axis_holds_zero_and_thick_bars_and_at_least_its_span() -> None:
    low, high = limits([row(0.01, 0.02, True)])
    assert low < 0 and high - low >= 0.5
    low, high = limits([row(1, 2, True), row(-50, 50, False)])
    assert -3 < low < 0 and 2 < high < 5  # a wide interval of one scene does not squeeze the others


def test_names_of_any_length_stay_inside_the_figure() -> None:
    rows = tuple(
        Row("a method $^" * 30, "a scene $^ " * 30, k, 0.1, -0.1, 0.3, True, False)
        for k in range(3)
    )
    figure = draw_forest(Forest("f", "b", "x", rows))
    figure.canvas.draw()
    for label in figure.axes[0].get_yticklabels():
        assert label.get_window_extent().x0 >= 0


def test_a_long_legend_leaves_the_chart_its_room() -> None:
    for words in ("a method with a name of several words", "short"):
        names = [f"{number} {words}" for number in range(30)]
        ours = [Series(n, k, (Point(float(k), 20.0, 19.0, 21.0),)) for k, n in enumerate(names)]
        figure = draw([Chart("c", "t", "x", "y", tuple(ours))])
        height = figure.axes[0].get_position().height * figure.get_size_inches()[1]
        assert height > 1.5  # inches


def test_many_methods_share_a_chart(tmp_path: Path) -> None:
    """Several capacities; a chart for each would be too tall."""
    for k in range(8):
        capacity = {"name": "evidence" if k else "fixed", "weight": 1.0}
        fake_run(tmp_path, "safi", f"reg{k}", run_name=f"r{k}", capacity=capacity)
    study = collect(tmp_path)
    assert all(len(panels) == 1 for panels in cost_charts(study, study.scenes[0]))


def test_an_axis_does_not_magnify_noise() -> None:
    points = (Point(1, 20.00, 19.999, 20.001), Point(2, 20.004, 20.003, 20.005))
    chart = Chart("c", "t", "x", "y", (Series("s", 0, points),), min_span=1.0)
    low, high = draw([chart]).axes[0].get_ylim()
    assert high - low == pytest.approx(1.0) and low < 20.0 < high


def test_only_real_gains_are_ringed(tmp_path: Path) -> None:
    for augment, gain in (("none", 0.0), ("dba", 0.03), ("safi", 3.0)):
        for seed in range(4):
            fake_run(tmp_path, augment, seed=seed, gain=gain)
    ((chart,), *_) = cost_charts(collect(tmp_path), "embedded")
    ringed = {series.name for series in chart.series if series.ringed}
    assert ringed == {"Baseline", "SAFI"}
    assert chart.min_span == 1.0


def test_a_figure_is_also_numbers(study_dir: Path) -> None:
    for name in ("differences", "tradeoff_embedded", "curves_embedded"):
        assert all((study_dir / f"{name}.{kind}").is_file() for kind in ("png", "svg", "csv"))
    with (study_dir / "differences.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [r["on"] for r in rows] == [
        "embedded °",
        "my_50%_{room}",
        "these 2 scenes",
        "scenes like these",
    ]
    assert [r["interval"] for r in rows][1:3] == ["this row alone", "all comparisons at once"]


def test_the_crop_is_where_renders_differ_most() -> None:
    one = np.zeros((40, 80, 3), np.uint8)
    other = one.copy()
    other[20:30, 40:60] = 200
    assert _window([one, other]) == (slice(20, 30), slice(40, 60))


@pytest.mark.parametrize(
    ("tags", "why"),
    [
        (("interpolating",) * 4, "interpolating, median"),
        (((),) * 2, "median and worst"),
        (((),) * 1, "the only one"),
        (((),) * 4, "median"),
    ],
)
def test_the_close_up_names_the_view_that_it_shows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, tags: Any, why: str
) -> None:
    monkeypatch.setattr(fakes, "TAGS", tuple((tag,) if tag else () for tag in tags))
    monkeypatch.setattr(fakes, "BASE_PSNR", fakes.BASE_PSNR[: len(tags)])
    for augment in ("none", "safi"):
        fake_run(tmp_path, augment)
    shown = draw_closeup(collect(tmp_path), "embedded")
    assert shown is not None and f"({why} by PSNR)" in shown.caption


@pytest.mark.parametrize(
    ("difference", "text"),
    [(-0.02, "-0.02"), (-0.002, "-0.002"), (0.0, "0.00"), (1e-9, "0.00"), (1.234, "+1.23")],
)
def test_a_difference_keeps_its_sign(difference: float, text: str) -> None:
    assert format_difference(difference) == text


def test_verdict_and_table_agree_about_a_small_difference(tmp_path: Path) -> None:
    for augment, values in (("none", (24.0, 24.1, 24.0)), ("safi", (22.5, 25.54, 24.0))):
        for seed, psnr in enumerate(values):
            path = fake_run(tmp_path, augment, seed=seed) / "record.json"
            record = json.loads(path.read_text())
            record["summary"]["psnr"]["mean"] = psnr
            path.write_text(json.dumps(record))
    build_report(tmp_path)
    text = (tmp_path / "report.md").read_text(encoding="utf-8")
    assert "SAFI: -0.02 dB" in text and " -0.02 |" in text


def test_doses_are_a_section(tmp_path: Path) -> None:
    dose = {"views_asked": 42, "views_made": 5, "own": "text | x", "acted_share": 0.12}
    for augment in ("none", "safi"):
        path = fake_run(tmp_path, augment) / "record.json"
        if augment == "safi":
            path.write_text(json.dumps(json.loads(path.read_text()) | {"dose": dose}))
    text = build_report(tmp_path).read_text(encoding="utf-8")
    section = text.partition("### What each method did")[2].partition("\n### ")[0]
    assert (
        "Epochs that asked for pseudo views" in section
        and " 42 " in section
        and "text \\| x" in section
    )
    assert "Baseline" not in section
    assert "Hardly tested" in text.partition("## Results")[0]


def test_no_two_scenes_share_a_file(tmp_path: Path) -> None:
    """Nor on a disk that ignores case; other names stay unchanged."""
    scenes = ("chair (1)", "chair-1", "Chair 1", "lamp 1", "größe", "grösse")
    for scene in scenes:
        for augment in ("none", "safi"):
            for seed in range(3):
                run_name = f"{scenes.index(scene)}-{augment}-{seed}"
                fake_run(tmp_path, augment, seed=seed, scene=scene, run_name=run_name)
    report = build_report(tmp_path)
    pictures = re.findall(r"^!\[.*\]\((.+)\)$", report.read_text(encoding="utf-8"), re.MULTILINE)
    assert len({name.lower() for name in pictures}) == len(pictures) > 2 * len(scenes)
    assert {"closeup_lamp_1.jpg", "curves_lamp_1.png"} <= {*pictures}
    build_report(tmp_path, photos=False)
    assert len(list(tmp_path.glob("closeup_*"))) == len(scenes)  # `embedded`, under other names


def test_no_two_panels_of_stresses_share_a_file(tmp_path: Path) -> None:
    for scene in ("Chair 1", "chair-1"):
        for views in (9, 6, 3):
            name = f"{scene[:2]}{views}"
            fake_run(tmp_path, scene=scene, condition={"n_views": views}, run_name=name)
    actual = panels(collect(tmp_path))
    assert len({panel.file.lower() for panel in actual}) == 2
