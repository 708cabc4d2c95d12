"""Render findings with templates: as Markdown, as one offline page, and as LaTeX.

`report.jinja`, `compare.jinja` and `leaderboard.jinja` define the order, and `sentences.jinja`
words the findings. `markdown.jinja` and `html.jinja` are the two forms of headings, paragraphs,
tables and pictures. Texts are plain except for backticks, which mark code. Each form escapes the
rest, so a name from outside cannot become markup. The page's content security policy allows its
script and style by their hashes and nothing from elsewhere.
"""

import base64
import functools
import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup, escape
from PIL import Image
from tabulate import tabulate

from framework.files.pages import policy_hash, script_json
from framework.files.whole import write_whole
from framework.report.figures.palette import DARK, LIGHT
from framework.report.statistics import numbers
from framework.report.study.methods import Method
from framework.report.study.scenes import MARK
from framework.report.study.words import code, joined, listed, outside
from framework.report.tables import Cell, Link, Result, Row
from framework.scenes.images import read_image

HOME = Path(__file__).parent
SCRIPTS = ("base", "tables", "viewer", "filter", "start")
CONTENTS = "@contents@"  # replaced by the table of contents once all headings are known
LONG = 12  # rows, from which on the page folds a table on a narrow screen
MANY = 12  # scenes, from which on Markdown folds what is about one scene
LEFT = {  # headings of columns of words
    *("Scene", "Method", "Compared with", "Parameters", "Folder", "Capacity", "View", "Video"),
    *("Run", "Kind", "Reason", "Again", "Option", "Options", "What", "Recipe"),
    *("Study", "Use", "Why", "Result"),
}
MARKS = ("{}", "**{}**", "<u>{}</u>")  # by rank, in Markdown
TEX = {
    **{character: f"\\{character}" for character in "&%$#_{}"},
    **{"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"},
    **{"<": r"\textless{}", ">": r"\textgreater{}", "|": r"\textbar{}", "°": r"\textdegree{}"},
    "†": r"$\dagger$",
}


@dataclass(frozen=True)
class Heading:
    level: int
    text: str
    anchor: str


@dataclass
class Page:
    """Inputs of a template besides the findings.

    Attributes:
        methods, scenes: values of the page's filters.
        folder: folder of the pictures, which are embedded in the page.
        data: data for the page's script.
        headings: list filled while the template is rendered.
    """

    title: str
    folder: Path
    methods: Sequence[Method] = ()
    scenes: Sequence[str] = ()
    data: Mapping[str, Any] = field(default_factory=dict)
    headings: list[Heading] = field(default_factory=list)

    def heading(self, level: int, text: str) -> Heading:
        """A heading with a link target that no other one has."""
        base = re.sub(r"[^\w\- ]", "", text.lower()).replace(" ", "-") or "section"
        used, name, number = {h.anchor for h in self.headings}, base, 1
        while name in used:
            name, number = f"{base}-{number}", number + 1
        self.headings.append(Heading(level, text, name))
        return self.headings[-1]

    def method_index(self, cell: object) -> int | None:
        if not isinstance(cell, Method) or cell.family not in self.methods:
            return None
        return list(self.methods).index(cell.family)

    def scene_index(self, cell: object) -> int | None:
        name = str(cell).removesuffix(f" {MARK}")
        return list(self.scenes).index(name) if name in self.scenes else None

    def copy_of(self, name: str) -> str:
        """A picture of the report as a data URI, at its own size."""
        return data_uri(webp_bytes(read_image(self.folder / name)))


def columns(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """The headings of a table; a row without one has an empty cell there."""
    return list(dict.fromkeys(name for row in rows for name in row))


def webp_bytes(pixels: Any, longest: int | None = None) -> bytes:
    """A picture as WebP, reduced to the longer side `longest` in pixels; None: as it is."""
    buffer = io.BytesIO()
    image = Image.fromarray(pixels)
    if longest is not None:
        image.thumbnail((longest, longest), Image.Resampling.LANCZOS)
    image.save(buffer, format="WEBP", quality=70, method=4)
    return buffer.getvalue()


def data_uri(content: bytes, kind: str = "image/webp") -> str:
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"


def publish(template: str, report: Path, page: Page, context: Mapping[str, Any]) -> None:
    """Write a report as Markdown, and as a page with the same name."""
    whole = render_page(template, page, **context)
    text = render(template, "markdown", page, **context)
    write_whole(report.with_suffix(".html"), whole)
    write_whole(report, text)


def render(template: str, kind: str, page: Page, **context: Any) -> str:
    """The body of a report.

    Args:
        kind: `markdown` or `html`.
    """
    page.headings = []
    body = templates().get_template(template).render(page=page, kind=kind, **context)
    parts: Any = templates().get_template(f"{kind}.jinja").make_module({"page": page, "kind": kind})
    body = body.replace(CONTENTS, str(parts.toc()))
    return re.sub(r"\n{3,}", "\n\n", re.sub(r"[ \t]+\n", "\n", body)).strip() + "\n"


def render_page(template: str, page: Page, **context: Any) -> str:
    """The report as one page that needs no network and no other file."""
    body = render(template, "html", page, **context)
    parts = "".join(_asset(f"{name}.js") for name in SCRIPTS)
    script, style = f'"use strict";\n(() => {{\n{parts}}})();\n', _colors() + _asset("page.css")
    policy = (
        "default-src 'none'; img-src data:; media-src data:;"
        f" script-src {policy_hash(script)};"
        f" style-src {policy_hash(style)}; base-uri 'none'; form-action 'none'"
    )
    data = {"scenes": page.scenes, "methods": [str(m) for m in page.methods], **page.data}
    whole = templates().get_template("page.html.jinja")
    return whole.render(
        title=page.title,
        policy=policy,
        style=Markup(style),
        body=Markup(body),
        data=Markup(script_json(data)),
        script=Markup(script),
    )


def say(macro: str, **context: Any) -> str:
    """A sentence as plain text, for the terminal."""
    module = templates().get_template("sentences.jinja").make_module(context)
    return _one_line(getattr(module, macro)()).replace("`", "")


def tex(template: str, **context: Any) -> str:
    """A LaTeX table."""
    return tex_templates().get_template(template).render(**context).strip() + "\n"


@functools.cache
def templates() -> Environment:
    """The templates of reports.

    `html.jinja` and `page.html.jinja` escape their values. The other templates write plain text,
    which passes through their macros.
    """
    env = _environment(autoescape=lambda name: bool(name) and "html.jinja" in str(name))
    env.filters |= {"html_prose": _html_prose, "markdown_prose": _markdown_prose}
    env.filters |= {"cell": _html_cell, "pipe_table": pipe_table, "columns": columns}
    env.filters |= {"listed": listed, "joined": joined, "outside": outside, "code": code}
    env.filters |= {
        name.removeprefix("format_"): getattr(numbers, name)
        for name in dir(numbers)
        if name.startswith("format_")
    }
    env.filters |= {**PLAIN_FILTERS, "average": numbers.average}
    env.globals |= {"CONTENTS": CONTENTS, "LONG": LONG, "MANY": MANY, "LEFT": LEFT}
    return env


@functools.cache
def tex_templates() -> Environment:
    """The templates of LaTeX tables, where braces are LaTeX's."""
    env = _environment(
        block_start_string="<%",
        block_end_string="%>",
        variable_start_string="<<",
        variable_end_string=">>",
        comment_start_string="<#",
        comment_end_string="#>",
    )
    env.filters |= {"tex": tex_text}
    return env


def _environment(**options: Any) -> Environment:
    return Environment(
        loader=FileSystemLoader(HOME / "templates"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        **options,
    )


PLAIN_FILTERS: dict[str, Any] = {
    "fixed": lambda value, places: f"{value:.{places}f}",
    "seconds": lambda value: numbers.ABSENT if value is None else f"{value:.1f}",
    "thousands": lambda value: f"{value:,.0f}",
    "short": lambda value: f"{value:g}",
    "level": lambda value: f"{float(numbers.format_significant(value)):g}",
    "percent_below_half": lambda share: f"{min(100 * share, 49.9):.{int(share >= 0.495)}f} %",
    "capitalize_first": lambda text: str(text)[:1].upper() + str(text)[1:],
}


def _one_line(text: object) -> str:
    return " ".join(str(text).split())


def _html_prose(text: object) -> Markup:
    """One escaped line; text in backticks is code. Text of a macro is plain, too."""
    parts = re.split(r"`([^`]*)`", str(escape(str(text))))
    line = "".join(f"<code>{p}</code>" if k % 2 else p for k, p in enumerate(parts))
    return Markup(_one_line(line))


def _markdown_prose(text: object) -> str:
    """One line in which, outside code, whatever would become a tag or a link is literal."""
    parts = re.split(r"(`[^`]*`)", _one_line(text))
    return "".join(
        part if part.startswith("`") else re.sub(r"<(?=[A-Za-z/!?])|(?<=\])\(", r"\\\g<0>", part)
        for part in parts
    )


def _html_cell(cell: Cell) -> Markup:
    if isinstance(cell, Link):
        return Markup('<a href="{}">{}</a>').format(cell.target, _html_prose(cell.text))
    return _html_prose(str(cell).replace(" ± ", "\u00a0±\u00a0"))


def pipe_table(rows: Sequence[Row]) -> str:
    """The Markdown of a table; the best result of a column is bold, the second underlined."""
    names = columns(rows)
    cells = [[_pipe_cell(row.get(name, "")) for name in names] for row in rows]
    align = ["left" if name in LEFT else "right" for name in names]
    headings = [_pipe_cell(name) for name in names]
    return tabulate(cells, headings, tablefmt="pipe", disable_numparse=True, colalign=align)


def _pipe_cell(cell: Cell) -> str:
    if isinstance(cell, Link):
        return f"[{_markdown_prose(cell.text)}]({cell.target})"
    if isinstance(cell, Result):
        return str(cell).replace(cell.text, MARKS[cell.rank].format(cell.text), 1)
    return _markdown_prose(cell).replace("|", "\\|")


def tex_text(text: object) -> str:
    """A text as LaTeX prints it."""
    return "".join(TEX.get(character, character) for character in str(text))


def _colors() -> str:
    def rules(colors: Sequence[str]) -> str:
        return "".join(f"--s{k}:{color};" for k, color in enumerate(colors))

    dark = f"@media (prefers-color-scheme: dark){{:root{{{rules(DARK)}}}}}\n"
    return f":root{{{rules(LIGHT)}}}\n{dark}"


def _asset(name: str) -> str:
    return (HOME / "assets" / name).read_text(encoding="utf-8")
