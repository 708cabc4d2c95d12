"""The last lines of a study: the verdict of its report, then where to look."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

from framework.errors import printable_line
from framework.files.program import program
from framework.records import RUN_FOLDERS
from framework.records.record import RECORD

SHOWN = 12  # lines of a verdict; the report has the rest


def closing(report: Path) -> list[str]:
    """Return the last lines of a study with this `report.md`.

    They are the verdict as plain text, how to view the run if there is only one, and the paths.
    """
    lines = _verdict(report.read_text(encoding="utf-8").splitlines() if report.is_file() else [])
    if len(lines) > SHOWN:
        lines = [*lines[: SHOWN - 1], f"- ... and {len(lines) - SHOWN + 1} more in the report"]
    page = report.with_suffix(".html")
    if lines:
        lines = ["", *(printable_line(line) for line in lines), ""]
    if len(list(report.parent.glob(f"{RUN_FOLDERS}/*/{RECORD}"))) == 1:
        folder = shlex.quote(str(short_path(report.parent)))
        lines.append(printable_line(f"view: {program()} view {folder}"))
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
