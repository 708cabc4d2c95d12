"""Numbers of README and docs are those that the records of committed studies give."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from benchmarks import results
from benchmarks.quoted import MARK, value, with_values
from framework.command.config.schema import ROOT

QUOTING = ("README.md", "docs/findings.md", "docs/literature.md")
# without a study: the line, or the first paragraph of its section, names the table or the history
SOURCE = re.compile(r"benchmarks/results/\w+\.md|git show \w+:")
NOT_TYPED = re.compile(
    r"^```.*?^```"  # code
    r"|<!-- table: \w+ -->\n\n(?:\|[^\n]*\n)+"
    rf"|{MARK.pattern}"
    r"|^[^\n]*<!-- published -->[^\n]*"  # lines with numbers by the authors of a method
    r"|`[^`\n]+`|\]\([^)\n]*\)",  # code and targets of links
    re.DOTALL | re.MULTILINE,
)
# a decimal number, or dB or CPU seconds without decimals; not an arXiv number or a version
NUMBER = re.compile(r"(?<![\w.])(?<!Python )[-+]?(?:\d*\.\d{1,3}(?![\d.])|\d+ (?:dB|CPU)\b)")


def typed(page: str) -> list[str]:
    """The lines of a page with a number that neither a record gives nor a link explains."""
    lines = []
    for section in re.split(r"^#+ [^\n]*$", NOT_TYPED.sub(_blank, page), flags=re.MULTILINE):
        first = section.strip().partition("\n\n")[0]
        if first.startswith("|") or not SOURCE.search(first):
            lines += section.splitlines()
    return [line for line in lines if NUMBER.search(line) and not SOURCE.search(line)]


def _blank(match: re.Match[str]) -> str:
    """Keep what explains the other numbers of a line."""
    return " ".join(SOURCE.findall(match[0]))


@pytest.mark.parametrize("page", QUOTING)
def test_no_number_of_a_page_is_typed(page: str) -> None:
    assert typed((ROOT / page).read_text("utf-8")) == []


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("SAFI gains 0.45 dB.", True),
        ("a ratio of 1.28, or LPIPS .125", True),
        ("- x\n\n- (0.19 to 0.70)", True),
        ("24 dB in 13 CPU seconds", True),
        ('SAFI gains <!-- = gain("a", "b") -->0.45 dB (0.19 to 0.70)<!-- --> and 0.3 dB.', True),
        ('SAFI gains <!-- = gain("a", "b") -->0.45 dB (0.19 to 0.70)<!-- -->.', False),
        ("the paper's 0.32<!-- published -->", False),
        ("`reg.p=0.05`, arXiv 2312.00451, OpenSplat 1.2.0, Python 3.11", False),
        ("0.75 dB ([table](../benchmarks/results/learned_depth.md))", False),
        ("## A\n\n`git show ba0d1932:docs/findings-evidence.md`\n\n- 0.8 dB", False),
        ("## A\n\ntext\n\n0.7 dB ([table](../benchmarks/results/learned_depth.md))\n0.8 dB", True),
        ("<!-- table: gains -->\n\n| a |\n| +0.40 |\n\ntext", False),
        ("| a |\n| +0.40 |", True),
        ("## A\n\n| 0.4 dB |\n| 0.3 dB, `git show ba0d1932:docs/findings-evidence.md` |", True),
    ],
)
def test_typed_numbers_are_found(text: str, found: bool) -> None:
    assert bool(typed(text)) == found


def test_numbers_are_those_of_the_committed_studies() -> None:
    """As `python benchmarks/results.py pages` writes them."""
    assert results.main(["pages", "--check"]) == 0


def test_a_changed_number_of_a_sentence_is_replaced() -> None:
    mark = '<!-- = gain("paper_fern", "SAFI") -->'
    page = f"SAFI gains {mark}0.45 dB (0.19 to 0.70)<!-- --> on fern.\n"
    assert with_values(page) == page
    assert with_values(page.replace("0.45", "0.54")) == page
    for wrong in (
        page.removeprefix("SAFI gains "),  # a comment at the start of a line ends the paragraph
        page.replace("<!-- -->", ""),
        page.replace('"SAFI")', '"SAFI") | string'),
    ):
        with pytest.raises(ValueError, match="expected a mark"):
            with_values(wrong)
    with pytest.raises(ValueError, match=r"expected one of DBA, .*; got SAFO"):
        with_values(page.replace('"SAFI"', '"SAFO"'))


def test_a_value_says_what_its_interval_is() -> None:
    """Corrected by default: of a scene alone, for the comparisons in this scene."""
    views = '"breakdown_views", "UAR", on="embedded (n_views=9)"'
    assert value(f"loss({views})") == "0.52 dB (-0.03 to 1.07)"
    assert value(f"loss({views}, corrected=false)") == "0.52 dB (0.14 to 0.91, uncorrected)"
    assert value(f"gain({views}).db") == "-0.52 dB"
    with pytest.raises(ValueError, match="expected a scene of paper_fern, got llff_horns"):
        value('gain("paper_fern", "SAFI", on="llff_horns")')
    alone = value('gain("paper_fern", "SAFI", corrected=false)')
    assert alone == "0.45 dB (0.33 to 0.56, uncorrected)"
    assert value('gain("best_methods5", "SAFI + UAR", on="others").span') == "-0.17 to 0.13"
    assert value('round(mean("paper_fern", "DropGaussian", "train_cpu_s"))') == "230"


def test_a_changed_number_of_a_table_is_replaced() -> None:
    page = "before\n\n<!-- table: t -->\n\n| a |\n| --- |\n| 1 |\n\nafter\n"
    rows = ["| a |", "| --- |", "| 2 |"]
    assert results.with_table(page, "t", rows) == page.replace("| 1 |", "| 2 |")
    assert results.with_table(results.with_table(page, "t", rows), "t", rows).count("| 2 |") == 1
    with pytest.raises(ValueError, match="table: other"):
        results.with_table(page, "other", rows)


def test_options_of_a_study_replace_those_of_its_scene() -> None:
    canon = {
        "scenes": {"fern": "scene=llff scene.path={data}/fern scene.n_views=3", "door": ""},
        "methods": "a,b",
    }
    study = {"options": "scene.n_views=2,3 method={methods}"}
    (words,) = results.commands_of(canon, "views", study, ["fern"], Path("/my data"))
    assert words == [
        "scene=llff",
        "scene.path=/my data/fern",
        "scene.n_views=2,3",
        "scene.downscale=2",
        "method=a,b",
        "study=results_views-fern",
    ]


def test_a_committed_report_links_to_nothing_absent(tmp_path: Path) -> None:
    (tmp_path / "kept.png").touch()
    chart = "![a](kept.png)\n\nA chart.{}\n\n"
    page = chart.format(" [SVG](gone.svg) [CSV](gone.csv)") + "![b](gone.png)\n\nGone.\n\nText.\n"
    assert results.without_absent(page, tmp_path) == chart.format("") + "Text.\n"
