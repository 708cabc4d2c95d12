"""No link of the documents is broken: its file is there, and its heading. Needs no extra; the site
is built by `test_site.py` where the extra `docs` is installed."""

import re
import subprocess
from pathlib import Path

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
    actual = HEADING.findall(re.sub(r"^```.*?^```", "", page.read_text("utf-8"), flags=re.M | re.S))
    plain = [re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", text).lower() for text in actual]
    return {re.sub(r"[^\w\- ]", "", text).strip().replace(" ", "-") for text in plain}


def test_every_link_leads_somewhere() -> None:
    gone = {page.relative_to(ROOT).as_posix(): broken(page) for page in PAGES}
    assert not {page: links for page, links in gone.items() if links}


def broken(page: Path) -> list[str]:
    """The links of a page to a file or heading that is not there; other sites are not asked."""
    links = []
    for link in LINK.findall(CODE.sub("", page.read_text("utf-8"))):
        target, _, anchor = link.partition("#")
        if re.match(r"[a-z]+:", link) or target in MADE:
            continue
        path = (page.parent / target).resolve() if target else page
        there = path.is_relative_to(ROOT) and path.exists()
        if not there or (anchor and anchor not in anchors(path)):
            links.append(link)
    return links


def test_committed_reports_show_the_photos_of_the_built_in_scene_alone() -> None:
    """Photos of other scenes are not ours to pass on: their licences forbid it."""
    listed = subprocess.run(
        ["git", "ls-files", "reports"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    photos = [name for name in listed.stdout.split() if name.endswith((".jpg", ".mp4", ".webp"))]
    assert [name for name in photos if "_embedded" not in Path(name).name] == []
