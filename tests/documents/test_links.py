"""No link of the documents is broken: its file is there, and its heading. Needs no extra; the site
is built by `test_site.py` where the extra `docs` is installed."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

from framework.command.config.schema import ROOT

PAGES = [
    *sorted(ROOT.glob("*.md")),
    *sorted((ROOT / "docs").rglob("*.md")),
    *sorted((ROOT / "benchmarks" / "results").glob("*.md")),
    *sorted((ROOT / "reports" / "committed").glob("*.md")),
    *sorted((ROOT / "reports" / "committed").glob("*/report.md")),
]
MADE = ("reference/options.md", "reference/api.md")  # by the site
CODE = re.compile(r"^```.*?^```|`[^`\n]*`", re.DOTALL | re.MULTILINE)
LINK = re.compile(r"(?<!\\)\]\(([^()\s]+)(?:\s+\"[^\"]*\")?\)")
HEADING = re.compile(r"^#{1,6} +(.+?)\s*$", re.MULTILINE)


def anchors(page: Path) -> set[str]:
    """What a link may name behind `#`: the headings in small letters, words joined by hyphens."""
    found = HEADING.findall(re.sub(r"^```.*?^```", "", page.read_text("utf-8"), flags=re.M | re.S))
    plain = [re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", text).lower() for text in found]
    return {re.sub(r"[^\w\- ]", "", text).strip().replace(" ", "-") for text in plain}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_its_links_lead_somewhere(page: Path) -> None:
    for link in LINK.findall(CODE.sub("", page.read_text("utf-8"))):
        if re.match(r"[a-z]+:", link):
            continue  # of another site, which a test does not ask
        target, _, anchor = link.partition("#")
        path = (page.parent / target).resolve() if target else page
        if target in MADE:
            continue
        assert path.is_relative_to(ROOT) and path.exists(), f"{link} is not there"
        assert not anchor or anchor in anchors(path), f"{link}: no such heading"


def test_committed_reports_show_the_photos_of_the_built_in_scene_alone() -> None:
    """Photos of other scenes are not ours to pass on: their licences forbid it."""
    listed = subprocess.run(
        ["git", "ls-files", "reports"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    photos = [name for name in listed.stdout.split() if name.endswith((".jpg", ".mp4", ".webp"))]
    assert [name for name in photos if "_embedded" not in Path(name).name] == []
