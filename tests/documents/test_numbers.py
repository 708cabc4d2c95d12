"""Numbers of README and docs come from the studies and tables that the page links to."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from framework.command.config.schema import ROOT

PAGES = ("README.md", "docs/findings.md", "docs/literature.md")
LINK = re.compile(r"\]\(([^)#\s]+\.md)")
NUMBER = re.compile(r"(?<![\w.,])(?:\d{1,3}(?:,\d{3})+|\d+)?(?:\.\d+)?(?![\w]|\.\d)")
SETTINGS = {
    "README.md": {"3.11", "10,000", "1.2.0"},
    "docs/findings.md": {"10,000", "1,000", "2,000"},
    "docs/literature.md": {"10,000", "30,000", "6,000"},
}


@pytest.mark.parametrize("page", PAGES)
def test_every_number_has_a_source(page: str) -> None:
    text = (ROOT / page).read_text("utf-8")
    known = {number for source in _sources(ROOT / page, text) for number in _numbers(source)}
    missing = [
        f"{number}: {line.strip()[:120]}"
        for line in _without_code(text).splitlines()
        for number in _numbers(line)
        if re.search(r"[.,]", number) and number not in SETTINGS[page]
        if not any(_same(number, other) for other in known)
    ]
    assert missing == []


def test_tables_are_those_of_the_committed_studies() -> None:
    """As `python benchmarks/results.py tables` writes them."""
    command = [sys.executable, "benchmarks/results.py", "tables", "--check"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def _sources(page: Path, text: str) -> list[str]:
    """Linked reports and tables, published values, and the generated tables of the page."""
    linked = [(page.parent / link).resolve() for link in LINK.findall(text)]
    linked += sorted((ROOT / "conf" / "published").rglob("*.*"))
    files = [path for path in linked if path.is_file() and path != page]
    if page.name == "README.md":  # quotes the findings
        files += [ROOT / "docs" / "findings.md"]
    tables = yaml.safe_load((ROOT / "benchmarks" / "canonical.yaml").read_text("utf-8"))["tables"]
    made = [
        "\n".join(re.findall(r"^\|.*", text.partition(f"<!-- table: {name} -->")[2], re.M))
        for name, spec in tables.items()
        if ROOT / spec["page"] == page
    ]
    return [path.read_text("utf-8", errors="replace") for path in files] + made


def _without_code(text: str) -> str:
    text = re.sub(r"^```.*?^```", "", text, flags=re.M | re.S)
    return re.sub(r"`[^`]*`|\]\([^)]*\)", "", text)


def _numbers(text: str) -> list[str]:
    return [number for number in NUMBER.findall(text) if number]


def _same(number: str, other: str) -> bool:
    """Whether one is the other, rounded to its own decimals."""
    first, second = (float(text.replace(",", "")) for text in (number, other))
    decimals = min(len(text.partition(".")[2]) for text in (number, other))
    return (abs(first - second) <= 0.5001 * 10**-decimals and decimals > 0) or first == second
