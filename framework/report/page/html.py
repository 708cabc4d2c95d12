"""A document as one HTML page that needs nothing else: no network, no other file.

Everything from outside is escaped: text as HTML, data as JSON in which `<` cannot occur. The page's
content security policy allows its own script and style by their hashes and nothing from elsewhere.
"""

from __future__ import annotations

import html
import re
from collections import Counter
from pathlib import Path

from framework.files.pages import filled, policy_hash, script_json
from framework.report.page.data import page_data
from framework.report.page.gallery import LONGEST, Gallery, inline_copy
from framework.report.parts.document import (
    Block,
    Bullets,
    Document,
    Heading,
    Link,
    Picture,
    Table,
    Text,
)
from framework.report.parts.palette import DARK, LIGHT
from framework.report.study.files import slug

ASSETS = Path(__file__).parent / "assets"
SCRIPTS = ("base", "link", "tables", "charts", "forest", "viewer", "filter", "start")
LONG = 12  # rows, from which on a table is folded on a narrow screen


def render(document: Document, pictures: Gallery, folder: Path) -> str:
    """The page. folder: where the figures' files are, which it takes in."""
    parts = "".join(_asset(f"{name}.js") for name in SCRIPTS)
    script, style = f'"use strict";\n(() => {{\n{parts}}})();\n', _colors() + _asset("page.css")
    body = _body(document, pictures, folder)
    return filled(
        _asset("page.html"),
        {
            "title": html.escape(document.title),
            "policy": "default-src 'none'; img-src data:; media-src data:;"
            f" script-src {policy_hash(script)};"
            f" style-src {policy_hash(style)}; base-uri 'none'; form-action 'none'",
            "style": style,
            "body": body,
            "data": script_json(page_data(document, pictures)),
            "script": script,
        },
    )


class Places:
    """Where the script draws: elements that count themselves, by kind."""

    def __init__(self) -> None:
        self._names: set[str] = set()
        self._counts: Counter[str] = Counter()

    def name(self, text: str) -> str:
        """An id for a heading, for links to it; none twice."""
        found = name = slug(text).lower()
        while name in self._names:
            self._counts[found] += 1
            name = f"{found}_{self._counts[found] + 1}"
        self._names.add(name)
        return name

    def next(self, kind: str) -> str:
        """An empty element for the next chart or forest plot of the page's data."""
        self._counts[kind] += 1
        return f'<div class="{kind}" data-{kind}="{self._counts[kind] - 1}"></div>'


def _body(document: Document, pictures: Gallery, folder: Path) -> str:
    """The blocks; one viewer stands for all image grids and their headings. What follows a scene's
    heading is wrapped, for the filter to hide."""
    parts: list[str] = []
    places = Places()
    viewed = inside = False
    for block, following in zip(document.blocks, (*document.blocks[1:], None), strict=True):
        if inside and isinstance(block, Heading):
            parts.append("</section>")
            inside = False
        if not (_is_grid(block) or (_is_grid(following) and _is_scene(block))):
            if document.begins_a_scene(block):
                parts.append(f'<section data-scene="{html.escape(block.text)}">')
                inside = True
            parts.append(_block(block, places, folder))
        elif not viewed:
            parts.append(_viewer(pictures))
            viewed = True
        if isinstance(block, Heading) and block.level == 1 and document.methods:
            parts.append(_asset("filter.html"))
    return "\n".join([*parts, *(["</section>"] if inside else [])])


def _is_grid(block: Block | None) -> bool:
    return isinstance(block, Picture) and block.grid


def _is_scene(block: Block) -> bool:
    return isinstance(block, Heading) and block.level == 3


def _block(block: Block, places: Places, folder: Path) -> str:
    match block:
        case Heading():
            return _heading(block, places)
        case Text():
            note = "<strong>Note.</strong> " if block.kind == "note" else ""
            return f'<p class="{block.kind}">{note}{_inline(block.text)}</p>'
        case Bullets():
            items = "".join(f"<li>{_inline(item)}</li>" for item in block.items)
            return f"<ul>{items}</ul>"
        case Table():
            return _table(block)
        case Picture():
            return _figure(block, places, folder)


def _heading(block: Heading, places: Places) -> str:
    name = html.escape(places.name(block.text))
    text = _inline(block.text)
    if block.level > 1:
        text = f'<a href="#{name}">{text}</a>'
    return f'<h{block.level} id="{name}">{text}</h{block.level}>'


def _table(table: Table) -> str:
    left = [name in table.left for name in table.columns]
    head = "".join(
        f'<th scope="col"{_class(is_left)}><button type="button">{_inline(name)}</button></th>'
        for name, is_left in zip(table.columns, left, strict=True)
    )
    rows = "".join(
        "<tr>"
        + "".join(
            f"<td{_class(is_left)}>{_cell(c)}</td>" for c, is_left in zip(row, left, strict=True)
        )
        + "</tr>"
        for row in table.rows
    )
    made = (
        f'<div class="scroll"><table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>'
        "</div>"
    )
    if len(table.rows) <= LONG:
        return made
    summary = f"<summary>A table of {len(table.rows)} rows</summary>"
    return f'<details class="long" open>{summary}{made}</details>'


def _class(is_left: bool) -> str:
    return ' class="left"' if is_left else ""


def _cell(cell: str | Link) -> str:
    if isinstance(cell, Link):
        return f'<a href="{html.escape(cell.target)}">{_inline(cell.text)}</a>'
    return _inline(cell.replace(" ± ", "\u00a0±\u00a0"))


def _figure(picture: Picture, places: Places, folder: Path) -> str:
    caption = f"<figcaption>{_inline(picture.caption)}</figcaption>"
    label = html.escape(picture.alt)
    if picture.charts or picture.forest:
        drawn = "".join(places.next("chart") for _ in picture.charts)
        drawn += places.next("forest") if picture.forest else ""
        return f'<figure aria-label="{label}">{drawn}{caption}</figure>'
    source = inline_copy(folder / picture.files[0])
    return f'<figure><img alt="{label}" src="{source}">{caption}</figure>'


def _viewer(pictures: Gallery) -> str:
    left = (
        f" {pictures.left_out} more do not fit into this page; they lie in the runs' folders."
        if pictures.left_out
        else ""
    )
    note = (
        "Move the slider from the ground truth over the render to its error map. Copies for looking"
        f" at, at most {LONGEST} pixels long; {len(pictures.shots)} pictures of runs.{left}"
    )
    return filled(_asset("viewer.html"), {"note": html.escape(note)})


def _inline(text: str) -> str:
    """Escaped; what stands in backticks is code."""
    parts = re.split(r"`([^`]*)`", html.escape(text))
    return "".join(f"<code>{p}</code>" if k % 2 else p for k, p in enumerate(parts))


def _colors() -> str:
    def rules(colors: tuple[str, ...]) -> str:
        return "".join(f"--s{k}:{color};" for k, color in enumerate(colors))

    dark = f"@media (prefers-color-scheme: dark){{:root{{{rules(DARK)}}}}}\n"
    return f":root{{{rules(LIGHT)}}}\n{dark}"


def _asset(name: str) -> str:
    return (ASSETS / name).read_text(encoding="utf-8")
