"""What a reader must be told about the runs of a study before their figures are believed."""

from __future__ import annotations

import math
import os
from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from framework.errors import UserError, printable_line
from framework.records.archive import ARCHIVE
from framework.records.failure import FAILED, read_failure
from framework.records.record import EXPOSURE, Run
from framework.report.study.folders import begun_dirs
from framework.report.study.labels import code, listed, outside
from framework.report.study.runs import BUSY, ReportRun

MOST_NAMED = 5
MOST_WARNINGS = 10


def notes(unique: Sequence[ReportRun], runs: Sequence[Run]) -> list[str]:
    """What `unique`, the runs that are reported, and `runs`, all complete ones, ask to be told."""
    return [
        *_warning_notes(unique),
        *_repeat_notes(unique),
        *_equal_notes(unique),
        *_still_notes(unique),
        *_code_notes(runs),
        *_machine_notes(unique),
        *_busy_notes(unique),
        *_exposure_notes(unique),
    ]


def _warning_notes(runs: Sequence[ReportRun]) -> list[str]:
    """Every distinct warning of the runs, with the scenes and the number of runs that gave it."""
    gave: dict[str, list[ReportRun]] = defaultdict(list)
    for run in runs:
        for text in run.record.warnings:
            gave[text].append(run)
    warned = []
    for text, those in gave.items():
        scenes = listed(sorted({run.scene for run in those}), "and")
        share = "" if len(those) == len(runs) else f", {len(those)} of {len(runs)} runs"
        warned.append(f"Warning ({scenes}{share}): {outside(text)}")
    if len(warned) <= MOST_WARNINGS:
        return warned
    more = len(warned) - MOST_WARNINGS
    return [*warned[:MOST_WARNINGS], f"{more} more warnings are in the runs' record.json."]


def begun_notes(folders: Sequence[Path]) -> list[str]:
    """Runs of these studies that left neither a result nor why there is none."""
    begun = [path.name for folder in folders for path in begun_dirs(folder)]
    if not begun:
        return []
    said = (
        "1 run was begun and has" if len(begun) == 1 else f"{len(begun)} runs were begun and have"
    )
    more = [f"{len(begun) - MOST_NAMED} more"] if len(begun) > MOST_NAMED else []
    named = listed([*(code(name) for name in begun[:MOST_NAMED]), *more], "and")
    return [
        f"{said} no result: still going, or killed ({named}). The study's command goes on with what"
        " was killed."
    ]


def within(path: Path, error: UserError) -> str:
    """The error, which tells the folder `path` and its files without the way to it."""
    below = str(error).replace(printable_line(f"{path}/"), "")
    return below.replace(printable_line(f"{path}:"), printable_line(f"{path.name}:"))


def _repeat_notes(runs: Sequence[ReportRun]) -> list[str]:
    """A complete run outlives a repetition that failed, which is told."""
    again = [run.run.run_dir for run in runs if os.path.lexists(run.run.run_dir / FAILED)]
    return [
        f"The run in {code(folder.name)} was repeated and failed"
        f" ({outside(_error_of(folder))}); the earlier, complete one is reported."
        for folder in again
    ]


def _error_of(folder: Path) -> str:
    try:
        return read_failure(folder).error
    except UserError as error:
        return within(folder, error)


def _equal_notes(runs: Sequence[ReportRun]) -> list[str]:
    """Methods that trained to the same bits: a test of their difference would be of nothing."""
    cells: dict[tuple[str, int, str], list[str]] = defaultdict(list)
    for run in runs:
        cells[run.scene, run.seed, run.record.parameters_sha256].append(run.method)
    found: dict[tuple[str, ...], dict[str, list[int]]] = defaultdict(lambda: defaultdict(list))
    for (scene, seed, bits), methods in cells.items():
        if bits and len(methods) > 1:
            found[tuple(methods)][scene].append(seed)
    told = []
    for alike, scenes in found.items():
        where = "; ".join(f"{scene}, {_seeds(seeds)}" for scene, seeds in scenes.items())
        told.append(
            f"{listed(alike, 'and')} trained to the same bits ({where}): what tells them apart"
            " never took effect there, so nothing was learned about it."
        )
    return told


def _still_notes(runs: Sequence[ReportRun]) -> list[str]:
    """Methods that seeds do not move: an interval over them is of no width, and of no chance."""
    cells: dict[tuple[str, str], list[float | None]] = defaultdict(list)
    for run in runs:
        cells[run.scene, run.method].append(run.mean("psnr"))
    found: dict[str, list[str]] = defaultdict(list)
    for (scene, method), values in cells.items():
        if len(values) > 1 and None not in values and len(set(values)) == 1:
            found[scene].append(method)
    if not found:
        return []
    told = "; ".join(f"{_some_names(methods)} on {scene}" for scene, methods in found.items())
    return [
        f"The same PSNR with every seed: {told}. Repeats say nothing about chance there, and what"
        " is made of them alone has an interval of no width."
    ]


def _some_names(methods: Sequence[str]) -> str:
    return listed(methods, "and") if len(methods) <= MOST_NAMED else f"{len(methods)} methods"


def _seeds(seeds: Sequence[int]) -> str:
    return f"seed{'s' if len(seeds) > 1 else ''} {listed(seeds, 'and')}"


def archive_notes(folders: Sequence[Path]) -> list[str]:
    """What a report lacks whose runs have no folders any more."""
    if not folders:
        return []
    return [f"Made from {code(ARCHIVE)}, as the folders of the runs were not kept: no pictures."]


def _code_notes(runs: Sequence[Run]) -> list[str]:
    sources = [run.record.provenance for run in runs]
    # older records hash the user's plugins into `code`, so take their commit's code instead
    of_commit = {_commit(p): str(p.get("code")) for p in sources if not _with_plugins(p)}
    versions = defaultdict[str, set[str]](set)
    for p in sources:
        hashed = str(p.get("code"))
        versions["code"].add(of_commit.get(_commit(p), hashed) if _with_plugins(p) else hashed)
        for name, digest in (p.get("plugins") or {}).items():
            versions[name].add(digest)
    return [
        f"The runs were made with {len(versions[name])} versions of"
        f" {'the code' if name == 'code' else code(name)}, which may explain a difference; the"
        " study's command repeats the outdated ones."
        for name in versions
        if len(versions[name]) > 1
    ]


def _commit(source: Mapping[str, Any]) -> str:
    """The commit, "" without one or with local changes."""
    git = source.get("git")
    return str(git["sha"]) if git and not git["dirty"] else ""


def _with_plugins(source: Mapping[str, Any]) -> bool:
    """Return whether `code` is of the user's plugins too."""
    return "own_plugins" in source and "plugins" not in source and bool(_commit(source))


def _machine_notes(runs: Sequence[ReportRun]) -> list[str]:
    """Seconds of different machines are no comparison of methods."""
    scenes = [
        scene
        for scene in dict.fromkeys(run.scene for run in runs)
        if len({run.machine for run in runs if run.scene == scene}) > 1
    ]
    if not scenes:
        return []
    found: dict[str, list[str]] = defaultdict(list)
    for run in runs:
        if run.scene in scenes:
            found[run.machine].append(run.method)
    told = [f"{name}: {_some_of(methods)}" for name, methods in found.items()]
    return [
        f"Runs of {listed(scenes, 'and')} were made on different machines ({'; '.join(told)}):"
        " their seconds do not compare, so nothing is advised by time there."
    ]


def _some_of(methods: Sequence[str]) -> str:
    """`5 runs of dba + none and none + none`, of many methods how many."""
    names = list(dict.fromkeys(methods))
    return f"{len(methods)} run{'s' if len(methods) > 1 else ''} of {_some_names(names)}"


def _exposure_notes(runs: Sequence[ReportRun]) -> list[str]:
    """Test views of such scenes are rendered as the photos around them were exposed."""
    sizes: dict[str, list[float]] = defaultdict(list)
    for run in runs:
        size = run.record.provenance.get(EXPOSURE)
        if isinstance(size, int | float) and math.isfinite(size):
            sizes[run.scene].append(100 * size)
    if not sizes:
        return []
    of = {scene: sum(run.scene == scene for run in runs) for scene in sizes}
    told = listed([_exposed(s, found, of[s]) for s, found in sorted(sizes.items())], "and")
    return [
        f"Photos were exposed differently ({told}, root mean square). They were made equal before"
        " the training, and test views are rendered as the photos around them were exposed"
        " (trainer.exposure)."
    ]


def _exposed(scene: str, percent: Sequence[float], n_runs: int) -> str:
    """By how much, and in how many of the scene's runs if not in all."""
    low, high = f"{min(percent):.0f}", f"{max(percent):.0f}"
    by = f"{scene} by {low if low == high else f'{low} to {high}'} %"
    return by if len(percent) == n_runs else f"{by} in {len(percent)} of {n_runs} runs"


def _busy_notes(runs: Sequence[ReportRun]) -> list[str]:
    """A training alone on its cores takes no more wall time than CPU time."""
    slowed = sum(run.disturbed for run in runs)
    if slowed == 0:
        return []
    return [
        f"While {slowed} of {len(runs)} trainings ran, other programs used the processor too (the"
        f" clock showed over {BUSY:g} times the CPU time). Charts of cost and the advice by time"
        " therefore count CPU seconds; tables give both; curves over time go by the clock."
    ]
