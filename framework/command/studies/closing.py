"""What a study leaves on the screen: the verdict of its report, then where that is."""

from __future__ import annotations

import re
from pathlib import Path

from framework.errors import printable_line

SHOWN = 12  # lines of a verdict; the report has the rest


def closing(report: Path) -> list[str]:
    """The lines for `report`, a `report.md` beside its page: the bold sentence that opens it and
    the list below, as plain text; none where it has no verdict."""
    lines = _verdict(report.read_text(encoding="utf-8").splitlines() if report.is_file() else [])
    if len(lines) > SHOWN:
        lines = [*lines[: SHOWN - 1], f"- ... and {len(lines) - SHOWN + 1} more in the report"]
    page = report.with_suffix(".html")
    if lines:
        lines = ["", *(printable_line(line) for line in lines), ""]
    if page.is_file():
        lines.append(printable_line(f"page: {short_path(page)}"))
    return [*lines, printable_line(f"report: {short_path(report)}")]


def _verdict(lines: list[str]) -> list[str]:
    """The lines of a report's verdict, without Markdown."""
    bold = next((n for n, line in enumerate(lines) if line.startswith("**")), None)
    if bold is None or not lines[bold].endswith("**"):
        return []
    verdict = [lines[bold].removeprefix("**").removesuffix("**")]
    for line in lines[bold + 1 :]:
        if line and not line.startswith("- "):
            break
        verdict += [line] if line else []
    return [re.sub(r"\\([<(])", r"\1", line) for line in verdict]


def short_path(path: Path) -> Path:
    """`path` relative to the current folder if it lies below, else as it is."""
    absolute = path.resolve()
    return absolute.relative_to(Path.cwd()) if absolute.is_relative_to(Path.cwd()) else absolute
