"""What two studies must share to count as equal: everything except measured times and memory.

`digests` copies a study and replaces every measured time by a constant: `timings`, `resumed` and
`peak_memory_bytes` of the records, hashes of the two tables, `render_s` of metrics.csv, `seconds`
of history.csv. It builds the report of the copy and hashes every file: records, tables, Gaussians,
renders, report and figures. Hydra's notes (`.hydra/`) are excluded.
"""

from __future__ import annotations

import csv
import hashlib
import json
import shutil
import tempfile
from pathlib import Path
from typing import Any

from framework.records.record import HISTORY_CSV, METRICS_CSV, RECORD
from framework.report import build_report

TITLE = "study"


def digests(study_dir: Path) -> dict[str, str]:
    """Path below the study -> SHA-256 of the file's content without measured times."""
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / TITLE
        shutil.copytree(study_dir / "runs", copy / "runs", ignore=shutil.ignore_patterns(".hydra"))
        for path in sorted(copy.rglob(RECORD)):
            _mask_record(path)
        for name, column in ((METRICS_CSV, "render_s"), (HISTORY_CSV, "seconds")):
            for path in sorted(copy.rglob(name)):
                _mask_column(path, column)
        build_report(copy, TITLE)
        files = sorted(path for path in copy.rglob("*") if path.is_file())
        return {str(path.relative_to(copy)): _sha256(path) for path in files}


def parameters(study_dir: Path) -> dict[str, str]:
    """Folder name of every complete run -> SHA-256 of its parameters."""
    records = {path.parent.name: _json(path) for path in study_dir.glob(f"runs/*/{RECORD}")}
    return {
        name: str(record["parameters_sha256"])
        for name, record in sorted(records.items())
        if record["status"] == "complete"
    }


def leftovers(study_dir: Path) -> list[str]:
    """Files that only an unfinished run has: temporaries, locks, checkpoints."""
    names = (".*.tmp", ".lock", "checkpoints")
    paths = [path for name in names for path in study_dir.rglob(name)]
    return sorted(str(path.relative_to(study_dir)) for path in paths)


def _mask_record(path: Path) -> None:
    record = _json(path)
    for entry in record["timings"]:
        entry["wall_s"] = entry["cpu_s"] = 1.0
    record["peak_memory_bytes"] = record["resumed"] = 0
    for name in (METRICS_CSV, HISTORY_CSV):  # hold times
        record.get("files", {}).pop(name, None)
    path.write_text(json.dumps(record, indent=2, sort_keys=True), encoding="utf-8")


def _mask_column(path: Path, column: str) -> None:
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.reader(file))
    index = rows[0].index(column)
    for number, row in enumerate(rows[1:]):
        row[index] = f"{number + 1}.0"
    with path.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows(rows)


def _json(path: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return content


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
