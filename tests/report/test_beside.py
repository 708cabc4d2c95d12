"""A report links what else shows a run: the page and the video in its folder, if they are there."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from framework.report import build_report
from tests.record.fakes import fake_run


@pytest.fixture
def study(tmp_path: Path) -> Path:
    """Two runs; the first has a page and a video."""
    first, _ = (fake_run(tmp_path, augment, run_name=augment) for augment in ("none", "safi"))
    (first / "view.html").write_text("page")
    (first / "video.webp").write_bytes(b"video")
    return tmp_path


def _looks(folder: Path, key: str = "looks") -> list[list[object]]:
    text = (folder / "report.html").read_text(encoding="utf-8")
    (data,) = re.findall(r'<script type="application/json"[^>]*>(.*?)</script>', text, re.DOTALL)
    return list(json.loads(data)[key])


def test_the_page_and_the_video_are_linked(study: Path) -> None:
    report = build_report(study).read_text(encoding="utf-8")
    assert "[in 3D](runs/none/view.html)" in report and "[video](runs/none/video.webp)" in report
    assert "runs/safi/view.html" not in report
    assert "`fishersplat view FOLDER` opens a run" in report
    links = [(one[2], *one[3:]) for one in _looks(study)]
    assert links == [(0, "in 3D", "runs/none/view.html"), (0, "video", "runs/none/video.webp")]


def test_without_any_there_is_no_column(study: Path) -> None:
    for name in ("view.html", "video.webp"):
        (study / "runs" / "none" / name).unlink()
    report = build_report(study).read_text(encoding="utf-8")
    assert not re.search(r"\| (View|Video) ", report) and _looks(study) == []


def test_a_report_to_pass_on_links_none(study: Path) -> None:
    report = build_report(study, photos=False).read_text(encoding="utf-8")
    assert "view.html" not in report and "fishersplat view" not in report
    assert _looks(study) == []


def test_the_page_holds_a_small_video_of_each_method(
    study: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    build_report(study)
    (video,) = _looks(study, "videos")
    assert video[2:] == [0, "data:image/webp;base64,dmlkZW8="]
    assert "media-src data:;" in (study / "report.html").read_text(encoding="utf-8")
    monkeypatch.setattr("framework.report.page.gallery.VIDEO_BYTES", 4)
    build_report(study)
    assert _looks(study, "videos") == [] and len(_looks(study)) == 2
