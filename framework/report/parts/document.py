"""A report as a list of blocks, which `markdown` and `page` write down.

Prose and cells are plain text in which only backticks mean something (`code`); the writers escape
all the rest, so a name from outside cannot become markup. What comes from outside has gone through
`labels.outside`, which takes its backticks away.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TypeGuard

from framework.report.parts.chart import Chart
from framework.report.parts.forest import Forest


@dataclass(frozen=True)
class Heading:
    """level: 1 is the title."""

    level: int
    text: str


@dataclass(frozen=True)
class Text:
    """A paragraph. kind: `verdict`, `finding`, `note` or `plain`."""

    text: str
    kind: str = "plain"


@dataclass(frozen=True)
class Bullets:
    items: tuple[str, ...]


@dataclass(frozen=True)
class Link:
    """A cell that leads to a file beside the report."""

    text: str
    target: str


@dataclass(frozen=True)
class Table:
    """columns: the headings. rows: a cell for each. left: the columns of words."""

    columns: tuple[str, ...]
    rows: tuple[tuple[str | Link, ...], ...]
    left: tuple[str, ...] = ()


@dataclass(frozen=True)
class Picture:
    """files: names beside the report, the one to show first. charts, forest: what it draws, of a
    chart or a forest plot. grid: whether the page shows these images in its viewer instead."""

    files: tuple[str, ...]
    alt: str
    caption: str
    charts: tuple[Chart, ...] = ()
    grid: bool = False
    forest: Forest | None = None


Block = Heading | Text | Bullets | Table | Picture


@dataclass(frozen=True)
class Document:
    """scenes, methods: by which the page can be filtered; a heading of level 3 that is a scene's
    name begins what is told of that scene alone. names: of the methods with their budgets, whose
    parts are the options to filter by. beside: whether the viewer opens with two runs."""

    title: str
    blocks: tuple[Block, ...] = field(default_factory=tuple)
    scenes: tuple[str, ...] = ()
    methods: tuple[str, ...] = ()
    names: tuple[str, ...] = ()
    beside: bool = False

    def begins_a_scene(self, block: Block) -> TypeGuard[Heading]:
        """Whether what follows, up to the next heading, is told of one scene alone."""
        return isinstance(block, Heading) and block.level == 3 and block.text in self.scenes


def table(rows: Sequence[Mapping[str, str | Link]], left: Sequence[str]) -> Table:
    """A table from rows by heading; a heading some rows lack is an empty cell there."""
    columns = tuple(dict.fromkeys(name for row in rows for name in row))
    cells = tuple(tuple(row.get(name, "") for name in columns) for row in rows)
    return Table(columns, cells, tuple(left))
