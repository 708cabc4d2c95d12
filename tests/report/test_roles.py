"""Which scenes chose defaults is data that a report tells; published figures carry their size."""

from __future__ import annotations

from pathlib import Path

import pytest

from framework.report import build_report
from framework.report.parts.document import Table, Text
from framework.report.study.collect import collect
from framework.report.study.roles import CHOSE, HELPED, TESTS, YOURS, marked, role, roles_sentence
from framework.report.text.published import published
from tests.record.fakes import fake_run


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (("embedded", "llff_fern", "lund_door", "nerf_fox", "dtu_scan24"), CHOSE),
        (("llff_horns", "llff_fortress", "llff_room"), TESTS),
        (("mip360_kitchen", "dtu_scan65"), HELPED),
        (("kitchen", "my room"), YOURS),
    ],
)
def test_every_scene_has_its_role(names: tuple[str, ...], expected: str) -> None:
    assert {role(name) for name in names} == {expected}


def test_the_sentence_and_the_mark() -> None:
    text = roles_sentence(["llff_fern", "llff_horns", "mine"])
    assert text == (
        "Scenes: llff_fern served to choose this project's defaults (marked °), which flatters them"
        " there; llff_horns only tested: no default was chosen there; mine of your own."
    )
    assert marked("llff_fern", "llff_fern") == "llff_fern °"
    assert marked("llff_horns", "llff_horns") == "llff_horns"


def test_scenes_that_chose_nothing_are_told_apart_alone(tmp_path: Path) -> None:
    for scene, gain in (("llff_fern", 3.0), ("llff_horns", -3.0)):
        for augment, own in (("none", 0.0), ("safi", gain)):
            for seed in range(4):
                fake_run(tmp_path, augment, seed=seed, gain=own, scene=scene)
    text = build_report(tmp_path).read_text(encoding="utf-8")
    assert "On llff_horns alone, where no test photo chose a default: safi + none costs" in text
    assert "| llff_fern ° |" in text and "| llff_horns " in text


def test_published_figures_carry_their_size_and_their_scenes(tmp_path: Path) -> None:
    fake_run(tmp_path, scene="llff_fern")
    blocks = published(collect(tmp_path))
    means, by_scene = (block for block in blocks if isinstance(block, Table))
    cells = {row[0]: row for row in means.rows}
    assert "(1/4)" in str(cells["CoR-GS"][3]) and "(1/8)" in str(cells["SAFI + UAR"][3])
    assert by_scene.rows[0] == (
        "llff_fern",
        "CoR-GS",
        "3",
        "22.29 / 0.745 / 0.196 (1/8)",
        "0.0862 (1/8)",
    )
    (text, _) = (block.text for block in blocks if isinstance(block, Text))
    assert "0.084 for DBA and 0.027 for SAFI" in text and "0.061 for uniform dropout" in text
    fake_run(tmp_path / "mine", scene="mine")
    assert len([b for b in published(collect(tmp_path / "mine")) if isinstance(b, Table)]) == 1
