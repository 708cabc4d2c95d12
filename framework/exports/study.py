"""The runs of a study that stand for its methods: of each, with each scene, the lowest seed."""

from __future__ import annotations

import json
from pathlib import Path

from framework.errors import require
from framework.files.opened import is_file
from framework.records import RUN_FOLDERS
from framework.records.record import RECORD, read_record


def is_study(folder: Path) -> bool:
    """Whether it is a study's folder, not a run's."""
    return not is_file(folder / RECORD) and (folder / RUN_FOLDERS).is_dir()


def runs_of_methods(folder: Path) -> list[Path]:
    """The complete runs, one for each configuration but for the seed. Raises UserError where there
    is none, or a record is damaged."""
    lowest: dict[str, tuple[int, Path]] = {}
    for file in sorted(folder.glob(f"{RUN_FOLDERS}/*/{RECORD}")):
        record = read_record(file)
        if record.status != "complete":
            continue
        scene = record.scene.name if record.scene else ""
        rest = {key: value for key, value in record.config.items() if key != "seed"}
        key = json.dumps([scene, rest], sort_keys=True, default=str)
        lowest[key] = min(lowest.get(key, (record.seed, file.parent)), (record.seed, file.parent))
    require(
        bool(lowest), f"{folder}: expected a study with a complete run, found none; run it again"
    )
    return sorted(run for _, run in lowest.values())
