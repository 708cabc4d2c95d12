"""A document as one HTML page that needs nothing else: no network, no other file.

Everything from outside is escaped: text as HTML, data as JSON in which `<` cannot occur. The page's
content security policy allows its own script and style by their hashes and nothing from elsewhere.
"""

from __future__ import annotations

import base64
import dataclasses
import hashlib
import html
import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from framework.report.page.gallery import LONGEST, Gallery
from framework.report.parts.chart import Chart, Series
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
from framework.report.parts.palette import DARK, DASHES, LIGHT, color_index, dash_index

ASSETS = Path(__file__).parent / "assets"
PLACEHOLDER = re.compile(r"\{\{(\w+)\}\}")


def render(document: Document, pictures: Gallery, folder: Path) -> str:
    """The page. folder: where the figures' files are, which it takes in."""
    script, style = _asset("page.js"), _colors() + _asset("page.css")
    charts: list[Chart] = []
    body = _body(document, pictures, charts, folder)
    return _filled(
        _asset("page.html"),
        {
            "title": html.escape(document.title),
            "policy": f"default-src 'none'; img-src data:; script-src {_hash(script)};"
            f" style-src {_hash(style)}; base-uri 'none'; form-action 'none'",
            "style": style,
            "body": body,
            "data": _json({"charts": [_chart(c) for c in charts], **_viewer_data(pictures)}),
            "script": script,
        },
    )


def _body(document: Document, pictures: Gallery, charts: list[Chart], folder: Path) -> str:
    """The blocks; one viewer stands for all image grids and their headings."""
    parts: list[str] = []
    viewed = False
    followers = (*document.blocks[1:], None)
    for block, following in zip(document.blocks, followers, strict=True):
        if not (_is_grid(block) or (_is_grid(following) and _is_scene(block))):
            parts.append(_block(block, charts, folder))
        elif not viewed:
            parts.append(_viewer(pictures))
            viewed = True
    return "\n".join(parts)


def _is_grid(block: Block | None) -> bool:
    return isinstance(block, Picture) and block.grid


def _is_scene(block: Block) -> bool:
    return isinstance(block, Heading) and block.level == 3


def _block(block: Block, charts: list[Chart], folder: Path) -> str:
    match block:
        case Heading():
            return f"<h{block.level}>{_inline(block.text)}</h{block.level}>"
        case Text():
            note = "<strong>Note.</strong> " if block.kind == "note" else ""
            return f'<p class="{block.kind}">{note}{_inline(block.text)}</p>'
        case Bullets():
            items = "".join(f"<li>{_inline(item)}</li>" for item in block.items)
            return f"<ul>{items}</ul>"
        case Table():
            return _table(block)
        case Picture():
            return _figure(block, charts, folder)


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
    return (
        f'<div class="scroll"><table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>'
        "</div>"
    )


def _class(is_left: bool) -> str:
    return ' class="left"' if is_left else ""


def _cell(cell: str | Link) -> str:
    if isinstance(cell, Link):
        return f'<a href="{html.escape(cell.target)}">{_inline(cell.text)}</a>'
    return _inline(cell)


def _figure(picture: Picture, charts: list[Chart], folder: Path) -> str:
    caption = f"<figcaption>{_inline(picture.caption)}</figcaption>"
    if picture.charts:
        first = len(charts)
        charts += picture.charts
        places = "".join(
            f'<div class="chart" data-chart="{first + k}"></div>'
            for k in range(len(picture.charts))
        )
        label = html.escape(picture.alt)
        return f'<figure aria-label="{label}">{places}{caption}</figure>'
    image = base64.b64encode((folder / picture.files[0]).read_bytes()).decode()
    source = f"data:image/jpeg;base64,{image}"
    return f'<figure><img alt="{html.escape(picture.alt)}" src="{source}">{caption}</figure>'


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
    return _filled(_asset("viewer.html"), {"note": html.escape(note)})


def _viewer_data(pictures: Gallery) -> dict[str, Any]:
    return {"images": pictures.images, "shots": pictures.shots}


def _chart(chart: Chart) -> dict[str, Any]:
    plain = {f.name: getattr(chart, f.name) for f in dataclasses.fields(chart)}
    return plain | {"series": [_series(one) for one in chart.series]}


def _series(series: Series) -> dict[str, Any]:
    """The style as numbers; points as [x, y, low, high, note], six digits."""
    points = [
        [*(float(f"{v:.6g}") for v in (p.x, p.y, p.y_low, p.y_high)), p.note] for p in series.points
    ]
    return {
        "name": series.name,
        "color": color_index(series.index),
        "dash": " ".join(str(2 * n) for n in DASHES[dash_index(series.index)]),
        "points": points,
        "faint": series.faint,
        "joined": series.joined,
        "ringed": list(series.ringed),
    }


def _inline(text: str) -> str:
    """Escaped; what stands in backticks is code."""
    parts = re.split(r"`([^`]*)`", html.escape(text))
    return "".join(f"<code>{p}</code>" if k % 2 else p for k, p in enumerate(parts))


def _json(value: Any) -> str:
    """JSON that can stand in a script element."""
    text = json.dumps(value, ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _filled(template: str, values: Mapping[str, str]) -> str:
    """`{{name}}` replaced in one pass, so that no value is read as a template."""
    return PLACEHOLDER.sub(lambda found: values[found[1]], template)


def _colors() -> str:
    def rules(colors: tuple[str, ...]) -> str:
        return "".join(f"--s{k}:{color};" for k, color in enumerate(colors))

    dark = f"@media (prefers-color-scheme: dark){{:root{{{rules(DARK)}}}}}\n"
    return f":root{{{rules(LIGHT)}}}\n{dark}"


def _asset(name: str) -> str:
    return (ASSETS / name).read_text(encoding="utf-8")


def _hash(text: str) -> str:
    digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
    return f"'sha256-{digest}'"
