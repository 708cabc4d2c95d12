"""The runs of one or more studies, each with the name of its method and of its scene."""

from __future__ import annotations

import os
import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations, product
from pathlib import Path
from types import MappingProxyType

from framework.errors import UserError, require
from framework.files.limits import RUNS
from framework.metrics.values import Missing
from framework.records import RUN_FOLDERS
from framework.records.failure import FAILED, read_failure
from framework.records.record import RECORD, Run, read_run
from framework.records.search import read_search
from framework.report.study.folders import run_dirs
from framework.report.study.labels import MethodLabel, code, method_labels, outside, scene_labels
from framework.report.study.notes import begun_notes, notes, table_notes, within
from framework.report.study.order import method_order, natural
from framework.report.study.recipes import NOTE, by_recipe
from framework.report.study.runs import DAMAGED, FailedRun, ReportRun, Study
from framework.report.study.shorten import shortened
from framework.report.study.tabled import is_tabled, method_label, read_tabled

DIGEST = re.compile(r"-s\d+-([0-9a-f]{8})$")  # of all options of a run but its seed, in its name


def collect(
    study_dirs: Path | Sequence[Path],
    out_dir: Path | None = None,
    broken: Mapping[Path, str] = MappingProxyType({}),
    rival: str = "",
) -> Study:
    """Read every record below the folders. out_dir: where the report goes, else the first folder.
    broken: folders of runs that turned out damaged, and why. rival: the method to compare the
    others with, by its name in the report, else plain training.

    A folder without runs is read from its table (`framework.report.study.tabled`). Raises UserError
    if a folder has neither, or no run is the rival's.
    """
    folders = [study_dirs] if isinstance(study_dirs, Path) else list(study_dirs)
    runs, failed, origins, told, tabled = _gathered(folders, broken)
    labelled, named = _label(runs, failed)
    labelled, named, told, apart = _told_apart(labelled, named, origins, told)
    short, shortened_notes = shortened([run.method_label for run in (*labelled, *told)])
    recipes = by_recipe(
        [(run.method_label, run.record.overrides, run.scene) for run in labelled]
        + [(method_label(run.method), run.overrides, run.scene) for run in named if run.method]
    )
    if recipes and not told:
        short, shortened_notes = recipes, [NOTE]
    labelled, told = (
        [replace(run, method_label=short[run.method]) for run in some] for some in (labelled, told)
    )
    named = [replace(run, method=_short(short, run.method)) for run in named]
    missing = _missing(labelled, named, origins, told)
    unique, repeated = _without_repeats([*labelled, *told])
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
            *table_notes(told, len(labelled)),
            *shortened_notes,
            *apart,
            *repeated,
            *notes(unique, runs),
            *begun_notes(folders),
        ),
        tuple(missing),
        linked=not tabled,
        tabled=tuple(tabled),
        searched=searched,
        rival=rival,
    )


def _gathered(
    folders: Sequence[Path], broken: Mapping[Path, str]
) -> tuple[list[Run], list[FailedRun], list[Path], list[ReportRun], list[Path]]:
    """Complete runs, failed ones, the folder that each complete one is of; what is told of those
    that are in a table alone, and the folders of such tables. A run that is in both is the
    folder's."""
    runs, failed, origins = [], [], []
    told: list[ReportRun] = []
    tabled = []
    for folder in folders:
        complete, lost = _read(folder, broken)
        if not complete and not lost and is_tabled(folder):
            told += [ReportRun(*parts) for parts in read_tabled(folder)]
            tabled.append(folder)
            continue
        require(
            len(complete) + len(lost) > 0,
            f"{folder}: expected a study's folder with runs in it, got none; give the folder that"
            " holds runs/, as reports/embedded",
        )
        runs += complete
        failed += lost
        origins += [folder] * len(complete)
    there = {_bits(run) for run in runs}
    told = [run for run in told if "" in _bits(run.run) or _bits(run.run) not in there]
    left = {run.run.run_dir.parent.parent for run in told}
    tabled = [folder for folder in tabled if folder in left]
    return runs, failed, origins, told, tabled


def _bits(run: Run) -> tuple[str, str]:
    """By which the same run is known in a folder and in a table; the second may be ""."""
    return run.run_dir.name, run.record.parameters_sha256[:12]


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
    kind, again = (last.kind, last.again) if last else ("", "")
    error = record.error or "not told"
    return FailedRun(path, error, kind, record.overrides, record.config, record.provenance, again)


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
    named = {
        run.run_dir: (method.full, scene.full)
        for run, method, scene in zip(known, methods[cut:], scenes[cut:], strict=True)
    }
    return labelled, [_named(run, *named.get(run.run_dir, ("", ""))) for run in failed]


def _short(short: Mapping[str, MethodLabel], method: str) -> str:
    """The short name of a method, its own where none of its runs is complete."""
    return short[method].full if method in short else method


def _named(run: FailedRun, method: str, scene: str) -> FailedRun:
    return replace(run, method=method, scene=scene)


def _missing(
    runs: Sequence[ReportRun],
    failed: Sequence[FailedRun],
    origins: Sequence[Path],
    told: Sequence[ReportRun],
) -> list[tuple[str, str, int]]:
    """What each folder lacks to be the full cross of its own scenes, methods and seeds, and no
    table has either."""
    there = {(run.scene, run.method, run.seed) for run in (*runs, *told)}
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


Ways = dict[int, tuple[str, str]]  # seed -> digest of all options but the seed, and the bits


def _told_apart(
    runs: list[ReportRun], failed: list[FailedRun], origins: Sequence[Path], told: list[ReportRun]
) -> tuple[list[ReportRun], list[FailedRun], list[ReportRun], list[str]]:
    """All runs and what is `told` in tables, which do not hold what all runs of a study share.
    Where one name is of runs with different options in two folders, each gets its folder's too."""
    every = [*runs, *told]
    at = [*origins, *(run.run.run_dir.parent.parent for run in told)]
    found: dict[tuple[str, str], dict[Path, Ways]] = defaultdict(lambda: defaultdict(dict))
    for run, folder in zip(every, at, strict=True):
        digest = DIGEST.search(run.run.run_dir.name)
        if digest is not None:
            own = found[run.scene, run.method][folder]
            own[run.seed] = digest[1], run.record.parameters_sha256[:12]
    clash = [
        key
        for key, folders in found.items()
        if any(_differ(one, two) for one, two in combinations(folders.values(), 2))
    ]
    if not told or not clash:
        return runs, failed, told, []

    def marked(label: MethodLabel, folder: Path) -> MethodLabel:
        source = f"from={outside(folder.resolve().name)}"
        return replace(label, options=", ".join(filter(None, (label.options, source))))

    named = [
        replace(run, method_label=marked(run.method_label, folder))
        for run, folder in zip(every, at, strict=True)
    ]
    lost = [
        replace(run, method=marked(method_label(run.method), run.run_dir.parent.parent).full)
        if run.method
        else run
        for run in failed
    ]
    scene, method = min(clash)
    note = (
        f"{method} on {scene} was run with options that are not all the same in these folders, and"
        " a table of runs does not name them: methods have the name of their folder (`from=`)."
    )
    return named[: len(runs)], lost, named[len(runs) :], [note]


def _differ(one: Ways, two: Ways) -> bool:
    """Whether two folders ran something else: other bits with a seed of both; without one, other
    options, where the seed is no part of them."""
    both = one.keys() & two.keys()
    if both:
        return any(
            one[s][0] != two[s][0] and (not one[s][1] or one[s][1] != two[s][1]) for s in both
        )
    first, second = ({digest for digest, _ in own.values()} for own in (one, two))
    return len(first) == len(second) == 1 and first != second


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
