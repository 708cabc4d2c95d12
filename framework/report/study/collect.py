"""The runs of one or more studies, each with the name of its method and of its scene."""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from types import MappingProxyType

from framework.errors import UserError, require
from framework.files.limits import RUNS
from framework.metrics.values import Missing
from framework.records import RUN_FOLDERS
from framework.records.archive import has_archive, read_archive
from framework.records.failure import FAILED, read_failure
from framework.records.record import RECORD, Run, read_run
from framework.records.search import read_search
from framework.report.study.folders import run_dirs
from framework.report.study.labels import code, method_labels, scene_labels
from framework.report.study.notes import archive_notes, begun_notes, notes, within
from framework.report.study.order import method_order, natural
from framework.report.study.recipes import NOTE, by_recipe
from framework.report.study.runs import DAMAGED, FailedRun, ReportRun, Study
from framework.report.study.shorten import shortened


def collect(
    study_dirs: Path | Sequence[Path],
    out_dir: Path | None = None,
    broken: Mapping[Path, str] = MappingProxyType({}),
    rival: str = "",
) -> Study:
    """Read every record below the folders. out_dir: where the report goes, else the first folder.
    broken: folders of runs that turned out damaged, and why. rival: the method to compare the
    others with, by its name in the report, else plain training.

    A folder without runs is read from its archive (`framework.records.archive`). Raises UserError
    if a folder has neither, or no run is the rival's.
    """
    folders = [study_dirs] if isinstance(study_dirs, Path) else list(study_dirs)
    runs, failed, origins, archived = _gathered(folders, broken)
    labelled, named = _label(runs, failed)
    short, shortened_notes = shortened([run.method_label for run in labelled])
    recipes = by_recipe(
        [(run.method_label, run.record.overrides, run.scene) for run in labelled]
        + [(run.method_label, run.overrides, run.scene) for run in named if run.method_label]
    )
    if recipes:
        short, shortened_notes = recipes, [NOTE]
    labelled = [replace(run, method_label=short[run.method]) for run in labelled]
    named = [replace(run, method_label=short.get(run.method, run.method_label)) for run in named]
    missing = _missing(labelled, named, origins)
    unique, repeated = _without_repeats(labelled)
    unique.sort(key=lambda r: (natural(r.scene), method_order(r.method), r.seed))
    known = sorted({run.method for run in unique}, key=method_order)
    require(
        not rival or rival in {*known, *(run.method_label.family for run in unique)},
        f"--baseline: expected a method of the report, got {rival!r}; give one of"
        f" {'; '.join(known)}",
    )
    searched = read_search(folders[0]) if len(folders) == 1 else None
    if searched is not None:
        missing = []  # no full cross: each trial is a method of its own
    return Study(
        out_dir or folders[0],
        tuple(unique),
        tuple(named),
        (
            *archive_notes(archived),
            *shortened_notes,
            *repeated,
            *notes(unique, runs),
            *begun_notes(folders),
        ),
        tuple(missing),
        linked=not archived,
        archived=tuple(archived),
        searched=searched,
        rival=rival,
    )


def _gathered(
    folders: Sequence[Path], broken: Mapping[Path, str]
) -> tuple[list[Run], list[FailedRun], list[Path], list[Path]]:
    """Complete runs, failed ones, the folder of each complete one, and the folders whose runs are
    in an archive alone."""
    runs, failed, origins, archived = [], [], [], []
    for folder in folders:
        complete, lost = _read(folder, broken)
        if not complete and not lost and has_archive(folder):
            complete, lost = _archived(folder)
            archived.append(folder)
        require(
            len(complete) + len(lost) > 0,
            f"{folder}: expected a study's folder with runs in it, got none; give the folder that"
            " holds runs/, as reports/embedded",
        )
        runs += complete
        failed += lost
        origins += [folder] * len(complete)
    return runs, failed, origins, archived


def _archived(folder: Path) -> tuple[list[Run], list[FailedRun]]:
    """The complete and the failed runs in a folder's archive."""
    complete: list[Run] = []
    failed: list[FailedRun] = []
    for entry in read_archive(folder):
        if entry.run.record.status == "complete":
            complete.append(entry.run)
        else:
            failed.append(_failed(entry.run, entry.kind, entry.again))
    return complete, failed


def _failed(run: Run, kind: str, again: str) -> FailedRun:
    record, error = run.record, run.record.error or "not told"
    own = record.overrides, record.config, record.provenance
    return FailedRun(run.run_dir, error, kind, *own, again)


def _read(folder: Path, broken: Mapping[Path, str]) -> tuple[list[Run], list[FailedRun]]:
    """All complete and all failed runs below `folder`, by path; one that is not what a run writes
    counts among the failed."""
    complete: list[Run] = []
    failed: list[FailedRun] = []
    paths = run_dirs(folder)
    studies = sorted({path.parent.parent for path in paths if path.parent.name == RUN_FOLDERS})
    require(
        len(studies) < 2,
        f"{folder}: expected the folder of one study, got that of {len(studies)}; give one of them,"
        f" as {studies[0] if studies else folder}, or several with --out DIR, or see fishersplat"
        " leaderboard",
    )
    for path in paths:
        try:
            if path in broken:
                raise UserError(broken[path])
            found = _read_run(path)
        except UserError as error:
            failed.append(FailedRun(path, within(path, error), DAMAGED, (), {}, {}))
            continue
        if isinstance(found, Run):
            complete.append(found)
        else:
            failed.append(found)
    return complete, failed


def _read_run(path: Path) -> Run | FailedRun:
    """Raises UserError where the files in the folder `path` are not those of a run."""
    if not os.path.lexists(path / RECORD):
        left = read_failure(path)
        return FailedRun(path, left.error, left.kind, left.overrides, left.config, {}, left.again)
    run = read_run(path)
    record = run.record
    if record.status == "complete":
        return run
    last = read_failure(path) if os.path.lexists(path / FAILED) else None
    return _failed(run, *((last.kind, last.again) if last else ("", "")))


def _label(
    runs: Sequence[Run], failed: Sequence[FailedRun]
) -> tuple[list[ReportRun], list[FailedRun]]:
    """Names among all runs, so that a failed run has the name its method has elsewhere."""
    known = [run for run in failed if run.config]
    configs = [run.record.config for run in runs] + [run.config for run in known]
    methods = method_labels(configs)
    scenes = scene_labels(configs, [run.record.scene for run in runs] + [None] * len(known))
    cut = len(runs)
    labelled = [ReportRun(*p) for p in zip(runs, methods[:cut], scenes[:cut], strict=True)]
    found = {
        run.run_dir: (method, scene.full)
        for run, method, scene in zip(known, methods[cut:], scenes[cut:], strict=True)
    }
    named = [
        replace(run, method_label=found[run.run_dir][0], scene=found[run.run_dir][1])
        if run.run_dir in found
        else run
        for run in failed
    ]
    return labelled, named


def _missing(
    runs: Sequence[ReportRun],
    failed: Sequence[FailedRun],
    origins: Sequence[Path],
) -> list[tuple[str, str, int]]:
    """What each folder lacks to be the full cross of its own scenes, methods and seeds."""
    there = {(run.scene, run.method, run.seed) for run in runs}
    there |= {(run.scene, run.method, run.seed) for run in failed if run.seed is not None}
    by_folder: dict[Path, list[ReportRun]] = defaultdict(list)
    for run, folder in zip(runs, origins, strict=True):
        by_folder[folder].append(run)
    crosses = [
        ({run.scene for run in own}, {run.method for run in own}, {run.seed for run in own})
        for own in by_folder.values()
    ]
    # no command asks for more, so what is larger was never meant as a cross
    asked = [(a, b, c) for a, b, c in crosses if len(a) * len(b) * len(c) <= RUNS]
    lacking = {cell for cross in asked for cell in product(*cross)} - there
    return sorted(lacking, key=lambda cell: (natural(cell[0]), method_order(cell[1]), cell[2]))


def _without_repeats(runs: list[ReportRun]) -> tuple[list[ReportRun], list[str]]:
    """One run per scene, method and seed: that of which most was measured, of equal ones the first
    by folder; the others are told."""
    kept: dict[tuple[str, str, int], ReportRun] = {}
    for run in runs:
        first = kept.setdefault((run.scene, run.method, run.seed), run)
        if _measured(run) > _measured(first):
            kept[run.scene, run.method, run.seed] = run
    told = [
        f"{run.method} on {run.scene} with seed {run.seed} was found twice; the run in"
        f" {code(run.run.run_dir.name)} is left out in favour of"
        f" {code(best.run.run_dir.name)}."
        for run in runs
        if (best := kept[run.scene, run.method, run.seed]) is not run
    ]
    return list(kept.values()), told


def _measured(run: ReportRun) -> int:
    """How many metrics the run has."""
    return sum(not isinstance(value, Missing) for value in run.record.summary.values())
