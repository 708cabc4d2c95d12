"""The runs of a study whose folders are gone or were never passed on, from its `runs.csv`.

The table holds what every comparison is made of: scene, method, seed, means over the test views,
sizes and seconds of training. It holds no views, no course over time and no failed run, so a report
from it has no pictures of its own and no section about these.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from framework.errors import UserError, require
from framework.files.limits import RUNS, TEXT_BYTES
from framework.files.opened import is_file, read_text
from framework.metrics.values import METRICS, Measurement, Missing
from framework.records import RUN_FOLDERS
from framework.records.record import METHOD_GROUPS, TRAIN_STAGE, Run, RunRecord, StageTime
from framework.records.record_check import check_number
from framework.records.run_files import Table
from framework.report.study.axes import BUDGETS, DATA_KEYS
from framework.report.study.labels import USUAL, MethodLabel, SceneLabel, outside

TABLE = "runs.csv"
ALSO = "also."  # begins the columns of what plugins measured
DOSE = "dose."  # and those of what the method did while it trained
CODE = "code"  # the column that tells of which code a run is
TOLD = "told"  # in the provenance of such a run: that column's text
PROTOCOL = "protocol"  # the column, and there, that tells which views trained and which tested
NEEDED = ("scene", "method", "seed", "psnr", "gaussians", "parameters", "train_wall_s", "run")
TOLD_BESIDE = ("ply_bytes", "parameters_sha256", PROTOCOL, CODE, "cpu", "overrides")
MEASURED = (*METRICS, *NEEDED, "train_cpu_s", *TOLD_BESIDE)
SPLIT = "scene.split"
MOST_GAUSSIANS = 10**9
CONDITIONS = re.compile(r" \((?=[\w.]+=|[0-9a-f]{8}\)$)")  # begins what follows a scene's name
PARTS = re.compile(r", (?=[\w.]+=)")  # between the parts of a method's name
Row = Mapping[str, str]


def is_tabled(folder: Path) -> bool:
    """Whether the folder holds a table of runs."""
    return is_file(folder / TABLE)


def read_tabled(folder: Path) -> list[tuple[Run, MethodLabel, SceneLabel]]:
    """The runs of `folder/runs.csv` with their labels. Raises UserError for another file."""
    path = folder / TABLE
    try:
        reader = csv.DictReader(io.StringIO(read_text(path, TEXT_BYTES), newline=""), strict=True)
        names = list(reader.fieldnames or ())
        lacking = [name for name in NEEDED if name not in names]
        if lacking or len(set(names)) < len(names):
            raise ValueError(f"it lacks {lacking[0]}" if lacking else "a column occurs twice")
        rows: list[dict[str, str]] = []
        for row in reader:
            if None in row or None in row.values():
                raise ValueError(f"line {reader.line_num} has not {len(names)} cells")
            require(len(rows) < RUNS, f"{path}: expected at most {RUNS:,} runs, got more")
            rows.append(row)
        return [_run(folder, row) for row in rows]
    except (ValueError, OverflowError, csv.Error) as error:
        raise UserError(
            f"{path}: expected a table of runs as a report writes it, got another"
            f" ({outside(str(error))}); build it again from the runs"
        ) from error


def method_label(name: str) -> MethodLabel:
    """The parts of a method's name, which stand in it in this order: augmenter and regularizer,
    options, limits, capacity with its options."""
    pair, *parts = PARTS.split(name)
    at = next((k for k, part in enumerate(parts) if part.startswith("capacity=")), len(parts))
    budgets = {key.rpartition(".")[2] for key in BUDGETS}
    limits = [part for part in parts[:at] if part.partition("=")[0] in budgets]
    options = [part for part in parts[:at] if part not in limits]
    return MethodLabel(pair, *(", ".join(some) for some in (options, limits, parts[at:])))


def _run(folder: Path, row: Row) -> tuple[Run, MethodLabel, SceneLabel]:
    scene, method = outside(row["scene"]), outside(row["method"])
    if not scene or not method or row["run"] in ("", ".", ".."):
        raise ValueError("a run without scene, method or name")
    name = CONDITIONS.split(scene, maxsplit=1)[0]
    flat = {key: _value(cell) for key, cell in row.items() if key not in MEASURED and cell}
    flat = {key: value for key, value in flat.items() if not key.startswith((ALSO, DOSE))}
    label = SceneLabel(scene, name, {key: flat[key] for key in DATA_KEYS if key in flat})
    views = Table({key: [] for key in ("view", "file", "tags")}, _empty(*METRICS, "render_s"))
    course = Table({}, _empty("step", "seconds", "test_psnr"))
    record = _record(row, {"scene.name": name, "trainer.steps": 0} | flat)
    return (
        Run(folder / RUN_FOLDERS / row["run"], record, views, course),
        method_label(method),
        label,
    )


def _record(row: Row, flat: Mapping[str, Any]) -> RunRecord:
    config: dict[str, Any] = {"seed": _whole(row["seed"], -(2**63), 2**63)}
    for key, value in flat.items():
        *groups, option = key.split(".")
        inner = config
        for group in groups:
            inner = inner.setdefault(group, {})
            if not isinstance(inner, dict):
                raise ValueError(f"the option {key} is in a value")
        inner[option] = value
    for (
        group
    ) in METHOD_GROUPS:  # a name that all runs share is no column; nor are `fixed`'s options
        named = config.setdefault(group, {})
        if isinstance(named, dict):
            named.setdefault("name", "not told" if named else USUAL.get(f"{group}.name", "none"))
    also = {outside(key.removeprefix(ALSO)): row[key] for key in row if key.startswith(ALSO)}
    dose = {
        outside(key.removeprefix(DOSE)): _value(row[key]) for key in row if key.startswith(DOSE)
    }
    gaussians = _whole(row["gaussians"], 0, MOST_GAUSSIANS)
    degree, banded = _bands(gaussians, _whole(row["parameters"], 0, 60 * MOST_GAUSSIANS))
    wall, cpu = (_number(row.get(name, "")) for name in ("train_wall_s", "train_cpu_s"))
    timed = wall is not None and cpu is not None
    return RunRecord(
        identity="",
        config=config,
        overrides=tuple(outside(row.get("overrides", "")).split()),
        scene=None,
        timings={TRAIN_STAGE: StageTime(wall, cpu)} if timed else {},  # type: ignore[arg-type]
        provenance=_provenance(row),
        gaussians=gaussians,
        sh_degree=degree,
        banded=banded,
        parameters_sha256=outside(row.get("parameters_sha256", "")),
        ply_bytes=_whole(row.get("ply_bytes") or "0", 0, 10**13),
        summary={metric: _measured(row.get(metric, "")) for metric in METRICS}
        | {name: _measured(cell) for name, cell in also.items() if name not in METRICS},
        dose={name: value for name, value in dose.items() if value != ""},
    )


def _provenance(row: Row) -> dict[str, Any]:
    cpu, _, cores = outside(row.get("cpu", "")).rpartition(", ")
    machine = {"cpu": cpu, "cores": cores.removesuffix(" cores")} if cpu else {}
    return {TOLD: outside(row.get(CODE, "")), PROTOCOL: _protocol(row), **machine}


def _protocol(row: Row) -> str:
    """Tables of before have no column for it, and tell of a split that was typed; "" of others."""
    typed = [w for w in row.get("overrides", "").split() if w.lstrip("+").startswith(f"{SPLIT}=")]
    told = typed[-1].partition("=")[2] if typed else ""
    return outside(row.get(PROTOCOL) or row.get(SPLIT) or told)


def _bands(gaussians: int, parameters: int) -> tuple[int, int]:
    """An SH degree, and how many Gaussians must have it, for so many parameters."""
    beyond = parameters - 14 * gaussians
    for degree in (3, 2, 1):
        each = 3 * ((degree + 1) ** 2 - 1)
        if beyond >= 0 and beyond % each == 0:
            return degree, beyond // each
    raise ValueError(f"{gaussians} Gaussians do not have {parameters} parameters")


def _measured(cell: str) -> Measurement:
    value = _number(cell)
    return Missing("not in the table") if value is None else value


def _number(cell: str) -> float | None:
    value = float(cell) if cell else None
    if value is not None:
        check_number("a value", value)
    return value


def _whole(cell: str, low: int, high: int) -> int:
    value = int(cell[:30])
    if not low <= value <= high:
        raise ValueError(f"a number is {cell}")
    return value


def _value(cell: str) -> object:
    """An option's value as the table has it."""
    for kind in (int, float):
        try:
            value = kind(cell[:400])
            check_number("an option", value)
            return value
        except ValueError:
            continue
    return {"True": True, "False": False}.get(cell, outside(cell))


def _empty(*names: str) -> dict[str, np.ndarray]:
    return {name: np.zeros(0) for name in names}
