"""What MkDocs is told while it builds the site: pages from outside `docs/`, the reference, the
order.

A link in a page is as in the repository, so that it works there, too; here it is turned to where
the page or file stands in the site. The reference is made anew at every build, of the tables that
`--help` shows and of docstrings.
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

# title -> pages, in their order; one that is not there yet is left out, one that no line names
# stands under the last title
NAV = {
    "Tutorials": [
        *("tutorials/first-study.md", "tutorials/own-photos.md", "tutorials/reading-a-report.md"),
        *("tutorials/stress-test.md", "tutorials/plugins.md"),
    ],
    "How to": [
        *("studies.md", "choices.md", "layouts.md", "photos.md", "view.md", "video.md"),
        "compare.md",
        *("exports.md", "launchers.md", "rasterizers.md", "trackers.md", "runs.md"),
    ],
    "Explanation": [
        *("methods.md", "statistics.md", "bits.md", "paper.md"),
        *("literature.md", "literature-evidence.md"),
    ],
    "Measured": ["findings.md", "findings-evidence.md", "benchmarks.md", "scenes.md"],
    "Reference": ["reference/options.md", "reference/api.md"],
    "Project": ["contributing.md", "architecture.md", "security.md", "changelog.md"],
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
    """Path in the repository -> path in the site, of all that the site holds from outside."""
    found = {source: place for source, place in OUTSIDE.items() if (ROOT / source).is_file()}
    for folder in FOLDERS:
        for path in sorted((ROOT / folder).rglob("*")):
            kinds = (".md", ".png", ".svg", ".jpg", ".csv", ".tex")
            name = path.relative_to(ROOT).as_posix()
            if path.is_file() and path.suffix in kinds and "/runs/" not in name:
                found[name] = name
    if (ROOT / "LICENSE").is_file():
        found["LICENSE"] = "LICENSE.txt"
    return found


def on_files(files: Files, config: Any) -> Files:
    """The site's files: those of docs/, of outside, and the reference."""
    for source, place in places().items():
        path = ROOT / source
        if place.endswith(".md"):
            text = path.read_text(encoding="utf-8")
            files.append(File.generated(config, place, content=text))
        else:
            files.append(File.generated(config, place, abs_src_path=str(path)))
    made = {"reference/options.md": options_page(), "reference/api.md": api_page()}
    for place, text in made.items():
        files.append(File.generated(config, place, content=text))
    config.nav = navigation({file.src_uri for file in files.documentation_pages()})
    return files


def navigation(pages: set[str]) -> list[Any]:
    """The menu of the pages there are."""
    listed = {title: [page for page in names if page in pages] for title, names in NAV.items()}
    named = {"index.md", *(page for names in listed.values() for page in names)}
    beside = sorted(p for p in pages - named if not p.startswith(FOLDERS))
    listed["Project"] += beside
    results = sorted(p for p in pages if p.startswith(FOLDERS[0]))
    reports = sorted(p for p in pages if p.startswith(FOLDERS[1]))
    listed["Measured"] += [{"Tables": results}, {"Reports": reports}]
    return ["index.md", *({title: names} for title, names in listed.items() if names)]


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Links as they lead in the site."""
    known = places()
    back = {place: source for source, place in known.items()}
    source = back.get(page.file.src_uri, f"docs/{page.file.src_uri}")

    def turned(match: re.Match[str]) -> str:
        target, anchor = match[1], match[2] or ""
        if re.match(r"[a-z]+:", target):
            return match[0]
        inside = posixpath.normpath(posixpath.join(posixpath.dirname(source), target))
        place = known.get(inside, inside.removeprefix("docs/"))
        return posixpath.relpath(place, posixpath.dirname(page.file.src_uri) or ".") + anchor

    def shown(match: re.Match[str]) -> str:
        """The text alone where a link leads to source code or to a run, which the site lacks."""
        inside = posixpath.normpath(posixpath.join(posixpath.dirname(source), match[2]))
        code = inside.endswith((".py", ".yaml")) and (ROOT / inside).is_file()
        run = re.match(r"reports/(committed/)?[^/]+/runs/", inside)
        return match[1] if code or run else match[0]

    return LINK.sub(turned, TEXT_LINK.sub(shown, markdown))


def on_page_content(html: str, **_: Any) -> str:
    """Formulas as MathML, which browsers draw without a script."""
    from latex2mathml.converter import convert

    def drawn(match: re.Match[str]) -> str:
        display = "block" if match[1] == "div" else "inline"
        return str(convert(unescape(match[2]).strip(), display=display))

    return MATHS.sub(drawn, html)


def api_page() -> str:
    """The contracts and values, of their docstrings."""
    return "# Contracts and values\n\n" + "\n".join(f"::: {name}\n" for name in API)


def options_page() -> str:
    """Every choice of every group with its options, as `--help` has them."""
    from framework.command.config.help import option_meanings, summary
    from framework.command.config.meanings import meanings
    from framework.command.config.schema import OBJECT_GROUPS, choices, rows
    from framework.options import TrainerOptions
    from framework.registry import plain_fields

    parts = ["# Options\n", "Of this version, from the tables behind `--help`.\n"]
    for group in OBJECT_GROUPS:
        parts.append(f"## `{group}`\n")
        for name in choices(group):
            parts.append(f"### `{group}={name}`\n\n{cell(summary(group, name))}\n")
            parts.append(table(group, rows(group, name), option_meanings(group, name)))
    parts.append("## `trainer`\n")
    parts.append(table("trainer", plain_fields(TrainerOptions), meanings(TrainerOptions)))
    return "\n".join(parts)


def table(group: str, rows: list[Any], means: dict[str, str]) -> str:
    """A Markdown table of options; "" for none."""
    if not rows:
        return ""
    lines = ["| option | default | meaning |", "|---|---|---|"]
    for name, _, field in rows:
        default = "required" if "MISSING" in repr(field.default) else f"`{field.default}`"
        lines.append(f"| `{group}.{name}` | {default} | {cell(means.get(name, ''))} |")
    return "\n".join([*lines, ""])


def cell(text: str) -> str:
    """A text within a table."""
    return " ".join(text.split()).replace("|", "\\|").replace("<", "&lt;").replace("[", "\\[")
