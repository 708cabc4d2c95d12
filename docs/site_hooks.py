"""MkDocs hooks: add pages from outside `docs/`, generate the reference and the navigation.

Links in pages are relative to the repository, so that they work there; `on_page_markdown` rewrites
them for the site. Every build generates the reference from the tables behind `--help` and from
docstrings.
"""

from __future__ import annotations

import posixpath
import re
import sys
from html import unescape
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

# title -> pages in order; a page that is not listed appears under the last title
NAV = {
    "Tutorials": [
        *("tutorials/first-study.md", "tutorials/own-photos.md", "tutorials/reading-a-report.md"),
        *("tutorials/python.md", "tutorials/plugins.md", "tutorials/stress-test.md"),
    ],
    "How-to guides": [
        *("studies.md", "photos.md", "layouts.md", "compare.md", "view.md", "video.md"),
        *("exports.md", "launchers.md", "rasterizers.md", "trackers.md"),
    ],
    "Reference": [
        *("choices.md", "reference/options.md", "reference/python.md", "plugins.md"),
        *("reference/api.md", "runs.md", "glossary.md", "scenes.md", "results.md"),
        "benchmarks.md",
        *("platforms.md", "dependencies.md"),
    ],
    "Explanation": [
        *("findings.md", "literature.md", "methods.md", "paper.md", "statistics.md", "bits.md"),
        *("decisions.md", "architecture.md"),
    ],
    "Project": ["contributing.md", "security.md", "changelog.md"],
}
OUTSIDE = {  # pages of the repository outside docs/
    "README.md": "index.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
    "SECURITY.md": "security.md",
}
FOLDERS = ("benchmarks/results", "reports/committed")  # whose pages and pictures are in it too
LINK = re.compile(r"(?<=\]\()([^)\s#]+)(#[^)\s]*)?(?=\))")
TEXT_LINK = re.compile(r"(?<!!)\[([^\[\]]+)\]\(([^)\s#]+)\)")
MATHS = re.compile(r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', re.DOTALL)
API = ("framework.plugin", "framework.types", "framework.errors", "framework.registry")


def places() -> dict[str, str]:
    """Map repository paths of pages and files outside docs/ to site paths."""
    pages = {source: place for source, place in OUTSIDE.items() if (ROOT / source).is_file()}
    for folder in FOLDERS:
        for path in sorted((ROOT / folder).rglob("*")):
            kinds = (".md", ".png", ".svg", ".jpg", ".csv", ".tex")
            name = path.relative_to(ROOT).as_posix()
            if path.is_file() and path.suffix in kinds and "/runs/" not in name:
                pages[name] = name
    if (ROOT / "LICENSE").is_file():
        pages["LICENSE"] = "LICENSE.txt"
    return pages


def on_files(files: Files, config: Any) -> Files:
    """Add the pages from outside docs/ and the reference."""
    for source, place in places().items():
        path = ROOT / source
        if place.endswith(".md"):
            text = path.read_text(encoding="utf-8")
            files.append(File.generated(config, place, content=text))
        else:
            files.append(File.generated(config, place, abs_src_path=str(path)))
    generated = {
        "reference/options.md": options_page(),
        "reference/python.md": "# Python interface\n\n::: fishersplat\n",
        "reference/api.md": api_page(),
    }
    for place, text in generated.items():
        files.append(File.generated(config, place, content=text))
    config.nav = navigation({file.src_uri for file in files.documentation_pages()})
    return files


def navigation(pages: set[str]) -> list[Any]:
    """Build the menu from the pages that exist."""
    listed = {title: [page for page in names if page in pages] for title, names in NAV.items()}
    named = {"index.md", *(page for names in listed.values() for page in names)}
    unlisted = sorted(p for p in pages - named if not p.startswith(FOLDERS))
    listed["Project"] += unlisted
    results = sorted(p for p in pages if p.startswith(FOLDERS[0]))
    reports = sorted(p for p in pages if p.startswith(FOLDERS[1]))
    listed["Reference"] += [{"Measurements": results}, {"Studies": reports}]
    return ["index.md", *({title: names} for title, names in listed.items() if names)]


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Rewrite links for the site."""
    moved = places()
    back = {place: source for source, place in moved.items()}
    source = back.get(page.file.src_uri, f"docs/{page.file.src_uri}")

    def rewritten(match: re.Match[str]) -> str:
        target, anchor = match[1], match[2] or ""
        if re.match(r"[a-z]+:", target):
            return match[0]
        inside = posixpath.normpath(posixpath.join(posixpath.dirname(source), target))
        place = moved.get(inside, inside.removeprefix("docs/"))
        return posixpath.relpath(place, posixpath.dirname(page.file.src_uri) or ".") + anchor

    def without_code(match: re.Match[str]) -> str:
        """Keep only the text of links to source code and runs, which are not part of the site."""
        inside = posixpath.normpath(posixpath.join(posixpath.dirname(source), match[2]))
        code = inside.endswith((".py", ".yaml")) and (ROOT / inside).is_file()
        run = re.match(r"reports/(committed/)?[^/]+/runs/", inside)
        return match[1] if code or run else match[0]

    return LINK.sub(rewritten, TEXT_LINK.sub(without_code, markdown))


def on_page_content(html: str, **_: Any) -> str:
    """Convert formulas to MathML, which needs no script, and make tables focusable."""
    from latex2mathml.converter import convert

    def mathml(match: re.Match[str]) -> str:
        display = "block" if match[1] == "div" else "inline"
        return str(convert(unescape(match[2]).strip(), display=display))

    # a focusable table scrolls by keyboard on narrow screens
    return MATHS.sub(mathml, html).replace("<table>", '<table tabindex="0">')


def on_post_page(output: str, **_: Any) -> str:
    """Name the search dialog for screen readers."""
    return output.replace('role="dialog"', 'role="dialog" aria-label="Search"', 1)


def api_page() -> str:
    """Generate the reference of plugin interfaces and types from their docstrings."""
    return "# Plugin interfaces and types\n\n" + "\n".join(f"::: {name}\n" for name in API)


def options_page() -> str:
    """Generate the list of all choices with their options, from the tables behind `--help`."""
    from framework.command.config.help import option_meanings, summary
    from framework.command.config.meanings import meanings
    from framework.command.config.schema import OBJECT_GROUPS, choices, rows
    from framework.options import TrainerOptions
    from framework.registry import plain_fields

    parts = ["# All options\n", "Generated from the tables behind `--help`.\n"]
    for group in OBJECT_GROUPS:
        parts.append(f"## `{group}`\n")
        for name in choices(group):
            parts.append(f"### `{group}={name}`\n\n{cell(summary(group, name))}\n")
            parts.append(table(group, rows(group, name), option_meanings(group, name)))
    parts.append("## `trainer`\n")
    parts.append(table("trainer", plain_fields(TrainerOptions), meanings(TrainerOptions)))
    return "\n".join(parts)


def table(group: str, rows: list[Any], means: dict[str, str]) -> str:
    """Format a Markdown table of options; "" if there are none."""
    if not rows:
        return ""
    lines = ["| option | default | meaning |", "|---|---|---|"]
    for name, _, field in rows:
        default = "required" if "MISSING" in repr(field.default) else f"`{field.default}`"
        lines.append(f"| `{group}.{name}` | {default} | {cell(means.get(name, ''))} |")
    return "\n".join([*lines, ""])


def cell(text: str) -> str:
    """Escape a text for a table cell."""
    return " ".join(text.split()).replace("|", "\\|").replace("<", "&lt;").replace("[", "\\[")
