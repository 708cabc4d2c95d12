"""A document as Markdown that reads well in a terminal too."""

from __future__ import annotations

import html
import re

from tabulate import tabulate

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

MANY = 12  # scenes, from which on what is told of one alone is folded


def render(document: Document) -> str:
    """The page's text; figures are referred to by names relative to it. With many scenes the parts
    of each are folded, so that what is about all of them can be found."""
    parts: list[str] = []
    folded = False
    for block in document.blocks:
        if folded and isinstance(block, Heading):
            parts.append("</details>")
            folded = False
        if len(document.scenes) >= MANY and document.begins_a_scene(block):
            parts.append(f"<details><summary>{html.escape(block.text)}</summary>")
            folded = True
        else:
            parts.append(_block(block))
    return "\n\n".join([*parts, *(["</details>"] if folded else [])]) + "\n"


def _block(block: Block) -> str:
    match block:
        case Heading():
            return f"{'#' * block.level} {_escaped(block.text)}"
        case Text():
            note = "**Note.** " if block.kind == "note" else ""
            bold = "**" if block.kind == "verdict" else ""
            return f"{note}{bold}{_escaped(block.text)}{bold}"
        case Bullets():
            return "\n".join(f"- {_escaped(item)}" for item in block.items)
        case Table():
            return _table(block)
        case Picture():
            return _picture(block)


def _picture(picture: Picture) -> str:
    first, *others = picture.files
    links = "".join(f" [{name.rpartition('.')[2].upper()}]({name})" for name in others)
    return f"![{_escaped(picture.alt)}]({first})\n\n{_escaped(picture.caption)}{links}"


def _table(table: Table) -> str:
    rows = [[_cell(cell) for cell in row] for row in table.rows]
    columns = [_cell(name) for name in table.columns]
    align = ["left" if name in table.left else "right" for name in table.columns]
    return tabulate(rows, columns, tablefmt="pipe", disable_numparse=True, colalign=align)


def _cell(cell: str | Link) -> str:
    if isinstance(cell, Link):
        return f"[{_escaped(cell.text)}]({cell.target})"
    return _escaped(cell).replace("|", "\\|").replace("\n", " ")


def _escaped(text: str) -> str:
    """Outside code, whatever would become a tag or a link is taken literally."""
    parts = re.split(r"(`[^`]*`)", text)
    return "".join(
        part if part.startswith("`") else re.sub(r"<(?=[A-Za-z/!?])|(?<=\])\(", r"\\\g<0>", part)
        for part in parts
    )
