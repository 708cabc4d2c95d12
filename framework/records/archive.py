"""`runs.jsonl`: all runs of a study in one file, one JSON object per line.

    {"schema": 1, "run": NAME, "record": {...}, "metrics": {...}, "history": {...},
     "kind": "", "again": ""}

`record` is the run's `record.json`; `metrics` and `history` are its tables by column, an empty
number is null. `kind` and `again` are of a failed run: the kind of error and the command that
repeats it. The file holds all that a report needs but the pictures.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from framework.errors import printable_line, require
from framework.files.documents import json_value
from framework.files.limits import RUNS, TEXT_BYTES
from framework.files.opened import is_file, read_text, reading
from framework.records import RUN_FOLDERS
from framework.records.provenance import strict_json
from framework.records.record import Run, record_content, record_of
from framework.records.record_check import check_columns, check_number, check_stems, check_views
from framework.records.run_files import LOGGED, TEXT_COLUMNS, Table

ARCHIVE, SCHEMA = "runs.jsonl", 1
LEFT_OUT = ("seed", "methods", "parameters", "files")  # from other fields, and of the folder alone


@dataclass(frozen=True)
class Entry:
    """A run of an archive.

    Attributes:
        kind, again: of a failed one, see above.
    """

    run: Run
    kind: str = ""
    again: str = ""

    @property
    def complete(self) -> bool:
        return self.run.record.status == "complete"


def archive(entries: Iterable[Entry]) -> str:
    """The text of an archive."""
    return "".join(f"{_line(entry)}\n" for entry in entries)


def has_archive(folder: Path) -> bool:
    return is_file(folder / ARCHIVE)


def read_archive(folder: Path) -> list[Entry]:
    """The runs of `folder/runs.jsonl`, which need not have folders of their own.

    Raises:
        UserError: the file is damaged, or of a newer schema.
    """
    path = folder / ARCHIVE
    lines = read_text(path, TEXT_BYTES).removesuffix("\n").split("\n")  # texts may hold U+2028
    require(len(lines) <= RUNS, f"{path}: expected at most {RUNS:,} runs, got {len(lines):,}")
    entries = []
    for number, line in enumerate(lines, 1):
        expected = f"a run of schema {SCHEMA} in line {number}"
        with reading(path, expected, "write the report again from the runs"):
            entries.append(_entry(folder, json_value(path, line)))
    return entries


def _line(entry: Entry) -> str:
    content = {
        "schema": SCHEMA,
        "run": printable_line(entry.run.run_dir.name),
        "record": {k: v for k, v in record_content(entry.run.record).items() if k not in LEFT_OUT},
        "metrics": _columns(entry.run.metrics),
        "history": _columns(entry.run.history),
        "kind": entry.kind,
        "again": entry.again,
    }
    return strict_json(content, compact=True)


def _entry(folder: Path, content: Mapping[str, Any]) -> Entry:
    if content["schema"] != SCHEMA:
        raise ValueError(f"schema {content['schema']}")
    name, kind, again = (str(content[key]) for key in ("run", "kind", "again"))
    if not name or Path(name).name != name:
        raise ValueError(f"the run's name is {name[:60]!r}")
    metrics = _table(content["metrics"], ("view", "tags", "file", "psnr", "render_s"))
    history = _table(content["history"], ("step", "seconds", "test_psnr"))
    run_dir = folder / RUN_FOLDERS / name
    record = record_of({"files": {}, **content["record"]})
    return Entry(Run(run_dir, record, metrics, history), kind, again)


def _columns(table: Table) -> dict[str, list[Any]]:
    numbers = {name: column.tolist() for name, column in table.numbers.items()}
    return {**table.texts, **numbers}


def _table(columns: Mapping[str, list[Any]], needed: Sequence[str]) -> Table:
    """The table with these columns; one of a failed run has none."""
    if columns:
        check_columns(list(columns), needed)
    if len({len(cells) for cells in columns.values()}) > 1:
        raise ValueError("columns of different lengths")
    texts = {name: list(map(str, columns[name])) for name in TEXT_COLUMNS if name in columns}
    numbers = {}
    for name, cells in columns.items():
        if name not in texts:
            values = [math.nan if cell is None else float(cell) for cell in cells]
            for value in values if not name.startswith(LOGGED) else ():
                if not math.isnan(value):
                    check_number(name, value)
            numbers[name] = np.array(values, dtype=np.float64)
    check_stems(texts.get("file", []))
    check_views(texts.get("view", []), texts.get("tags", []))
    return Table(texts, numbers)
