"""Forest plot, axes, close-ups, and the same figures as numbers and as LaTeX."""

import csv
import re
from pathlib import Path
from typing import Any

import pytest

from framework.report import build_report
from framework.report.figures.pictures import draw_closeup
from framework.report.statistics.numbers import format_difference
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


def test_no_two_scenes_share_a_file(tmp_path: Path) -> None:
    """Nor on a disk that ignores case; other names stay unchanged."""
    scenes = ("chair (1)", "Chair 1", "lamp 1")
    for scene in scenes:
        for augment in ("none", "safi"):
            for seed in range(3):
                run_name = f"{scenes.index(scene)}-{augment}-{seed}"
                fake_run(tmp_path, augment, seed=seed, scene=scene, run_name=run_name)
    report = build_report(tmp_path).path
    pictures = re.findall(r"^!\[.*\]\((.+)\)$", report.read_text(encoding="utf-8"), re.MULTILINE)
    assert len({name.lower() for name in pictures}) == len(pictures) > 2 * len(scenes)
    assert {"closeup_lamp_1.jpg", "curves_lamp_1.png"} <= {*pictures}
    build_report(tmp_path, photos=False)
    assert len(list(tmp_path.glob("closeup_*"))) == len(scenes)  # `embedded`, under other names
