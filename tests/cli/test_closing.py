"""What a study leaves on the screen: the verdict, the page, the report."""

from __future__ import annotations

from pathlib import Path

import pytest

from framework.command.studies.closing import SHOWN, closing

REPORT = """# first

**Use none + none (plain training): nothing tested was \\<b>shown\\</b> to be better.**

- Really different: safi + uar costs 0.15 dB (-0.28 to -0.02).
- Steadier: nobody shown.

A method is named augmenter + regularizer.

- another list
"""


def test_the_verdict_then_the_page_then_the_report(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    report = tmp_path / "reports/first/report.md"
    report.parent.mkdir(parents=True)
    report.write_text(REPORT, encoding="utf-8")
    report.with_suffix(".html").write_text("", encoding="utf-8")
    assert closing(report) == [
        "",
        "Use none + none (plain training): nothing tested was <b>shown</b> to be better.",
        "- Really different: safi + uar costs 0.15 dB (-0.28 to -0.02).",
        "- Steadier: nobody shown.",
        "",
        "page: reports/first/report.html",
        "report: reports/first/report.md",
    ]


def test_a_long_verdict_is_cut(tmp_path: Path) -> None:
    report = tmp_path / "report.md"
    report.write_text("**Use it.**\n\n" + "- a point\n" * 40, encoding="utf-8")
    lines = closing(report)
    assert len(lines) == SHOWN + 3
    assert lines[SHOWN] == "- ... and 30 more in the report"
