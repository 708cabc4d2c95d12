"""Read the runs of one or more studies, with the method and the scene of each."""

import os
from collections import defaultdict
from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path

from framework.errors import UserError, os_line, printable_line, require
from framework.files.limits import RUNS
from framework.metrics.values import Missing
from framework.records import RUN_FOLDERS
from framework.records.archive import Entry, has_archive, read_archive
from framework.records.record import FAILED, LEARNED, RECORD, Run, RunRecord, read_failure, read_run
from framework.records.search import read_search
from framework.report.study.methods import Method, name_methods
from framework.report.study.scenes import scene_labels
from framework.report.study.study import DAMAGED, FailedRun, ReportRun, Study
from framework.report.study.words import code, natural, outside

DEPTH = 12  # folders between a study and its runs; links are not followed


def collect(
    study_dirs: Path | Sequence[Path],
    out_dir: Path | None = None,
    rival: str = "",
) -> Study:
    """Read every record below the folders.

    Args:
        study_dirs: folders with runs, or with an archive of them.
        out_dir: folder of the report. The default is the first folder.
        rival: display or registry name of the baseline; "" for training without a method.

    Raises:
        UserError: A folder has neither runs nor an archive, or no run is of that baseline.
    """
    folders = [study_dirs] if isinstance(study_dirs, Path) else list(study_dirs)
    runs, failed, origins, archived = _gathered(folders)
    labelled, named, notes = _label(runs, failed)
    missing = _missing(labelled, named, origins)
    unique, repeated = _without_repeats(labelled)
    unique.sort(key=lambda r: (natural(r.scene), r.method.order, r.seed))
    searched = read_search(folders[0]) if len(folders) == 1 else None
    return Study(
        out_dir or folders[0],
        tuple(unique),
        tuple(named),
        (*notes, *repeated),
        # the trials of a search are no full cross: each is a separate method
        tuple(missing) if searched is None else (),
        linked=not archived,
        archived=tuple(archived),
        searched=searched,
        rival=find_rival(rival, unique),
        sources=tuple(run.record.provenance for run in runs),
        begun=tuple(path.name for folder in folders for path in begun_dirs(folder)),
    )


def find_rival(text: str, runs: Sequence[ReportRun]) -> Method | None:
    """The method, or the family of methods, that is called so. Raises UserError if there is
    none."""
    if not text:
        return None
    methods = sorted({run.method for run in runs}, key=lambda method: method.order)
    families = dict.fromkeys(method.family for method in methods)
    for method in (*families, *methods):
        if method.is_called(text):
            return method
    raise UserError(
        f"--baseline: expected a method of the report, got {text!r}; give one of"
        f" {'; '.join(dict.fromkeys(method.label for method in (*families, *methods)))}"
    )


def _gathered(
    folders: Sequence[Path],
) -> tuple[list[Run], list[FailedRun], list[Path], list[Path]]:
    """Complete runs, failed ones, the folder of each complete one, and the folders whose runs are
    in an archive alone."""
    runs, failed, origins, archived = [], [], [], []
    for folder in folders:
        entries = _read(folder)
        if not entries and has_archive(folder):
            entries = read_archive(folder)
            archived.append(folder)
        require(
            len(entries) > 0,
            f"{folder}: expected a study's folder with runs in it, got none; give the folder that"
            " holds runs/, as reports/embedded",
        )
        complete = [entry.run for entry in entries if entry.complete]
        runs += complete
        origins += [folder] * len(complete)
        failed += [FailedRun(e.run, e.kind, e.again) for e in entries if not e.complete]
    return runs, failed, origins, archived


def _read(folder: Path) -> list[Entry]:
    """All runs below `folder`, by path; one that no run wrote counts as failed. A study does not
    have the runs of studies in its folder, as `study=a/b` is in that of `study=a`."""
    paths = run_dirs(folder)
    studies = sorted({path.parent.parent for path in paths if path.parent.name == RUN_FOLDERS})
    if folder in studies:
        others = [study / RUN_FOLDERS for study in studies if study != folder]
        paths = [path for path in paths if path.parent not in others]
        studies = [folder]
    require(
        len(studies) < 2,
        f"{folder}: expected the folder of one study, got that of {len(studies)}; give one of them,"
        f" as {studies[0] if studies else folder}, or several with --out DIR, or see fishersplat"
        " leaderboard",
    )
    entries = []
    for path in paths:
        try:
            entries.append(_read_run(path))
        except UserError as error:
            record = RunRecord.failed(_within(path, error), {}, (), {})
            entries.append(Entry(Run(path, record), DAMAGED))
    return entries


def _within(path: Path, error: UserError) -> str:
    """The error, with the folder `path` and its files named without the path to it."""
    below = str(error).replace(printable_line(f"{path}/"), "")
    return below.replace(printable_line(f"{path}:"), printable_line(f"{path.name}:"))


def _read_run(path: Path) -> Entry:
    """Raises UserError if the files in the folder `path` are not those of a run."""
    if not os.path.lexists(path / RECORD):
        left = read_failure(path)
        record = RunRecord.failed(left.error, {}, left.overrides, {})
        return Entry(Run(path, record), left.kind, left.again)
    entry = Entry(read_run(path))
    if entry.complete or not os.path.lexists(path / FAILED):
        return entry
    last = read_failure(path)
    return replace(entry, kind=last.kind, again=last.again)


def _label(
    runs: Sequence[Run], failed: Sequence[FailedRun]
) -> tuple[list[ReportRun], list[FailedRun], list[str]]:
    """Name all runs together, so that a failed run has the method that it has elsewhere; with notes
    on the names."""
    readable = [run for run in failed if run.record.config]
    records = [run.record for run in runs] + [run.record for run in readable]
    configs = [record.config for record in records]
    scenes = scene_labels(configs, [record.scene for record in records])
    overrides = [record.overrides for record in records]
    methods, notes = name_methods(configs, overrides, [scene.full for scene in scenes])
    learned = [str(run.record.provenance.get(LEARNED) or "") for run in runs]
    weights = {m: outside(w) for m, w in zip(methods, learned, strict=False) if w}
    methods = [replace(method, learned=weights.get(method, "")) for method in methods]
    labels = list(zip(methods, scenes, strict=True))
    complete = [ReportRun(run, *label) for run, label in zip(runs, labels, strict=False)]
    rest = iter(labels[len(runs) :])

    def named(run: FailedRun) -> FailedRun:
        method, scene = next(rest)
        return replace(run, method=method, scene=scene.full)

    return complete, [named(run) if run.record.config else run for run in failed], notes


def _missing(
    runs: Sequence[ReportRun], failed: Sequence[FailedRun], origins: Sequence[Path]
) -> list[tuple[str, Method, int]]:
    """List what each folder lacks for the full cross of its scenes, methods and seeds."""
    present: set[tuple[object, ...]] = {(run.scene, run.method, run.seed) for run in runs}
    present |= {(run.scene, run.method, run.seed) for run in failed}
    by_folder: dict[Path, list[ReportRun]] = defaultdict(list)
    for run, folder in zip(runs, origins, strict=True):
        by_folder[folder].append(run)
    crosses = [
        ({run.scene for run in runs}, {run.method for run in runs}, {run.seed for run in runs})
        for runs in by_folder.values()
    ]
    # no command starts more runs, so a larger cross was never meant
    meant = [(a, b, c) for a, b, c in crosses if len(a) * len(b) * len(c) <= RUNS]
    lacking = {cell for cross in meant for cell in product(*cross)} - present
    return sorted(lacking, key=lambda cell: (natural(cell[0]), cell[1].order, cell[2]))


def _without_repeats(runs: list[ReportRun]) -> tuple[list[ReportRun], list[str]]:
    """One run per scene, method and seed: the one with the most metrics, of equal ones the first by
    folder; a note names the others."""
    kept: dict[tuple[str, Method, int], ReportRun] = {}
    for run in runs:
        first = kept.setdefault((run.scene, run.method, run.seed), run)
        if _n_metrics(run) > _n_metrics(first):
            kept[run.scene, run.method, run.seed] = run
    repeats = [
        f"{run.method} on {run.scene} with seed {run.seed} ran twice; the run in"
        f" {code(run.run.run_dir.name)} is left out in favour of {code(best.run.run_dir.name)}."
        for run in runs
        if (best := kept[run.scene, run.method, run.seed]) is not run
    ]
    return list(kept.values()), repeats


def _n_metrics(run: ReportRun) -> int:
    return sum(not isinstance(value, Missing) for value in run.record.summary.values())


def walked(folder: Path) -> Iterator[tuple[Path, set[str]]]:
    """`folder` and the folders below it, each with the names in it."""
    waiting = [(folder, 0)]
    while waiting:
        place, depth = waiting.pop()
        names, below = _content(place)
        yield place, names
        if depth < DEPTH:
            waiting += [(place / name, depth + 1) for name in below]


def run_dirs(folder: Path) -> list[Path]:
    """The folders of complete and failed runs, sorted."""
    return sorted(place for place, names in walked(folder) if holds_run(names))


def holds_run(names: Collection[str]) -> bool:
    """Whether a folder with these names in it is that of a run."""
    return RECORD in names or FAILED in names


def begun_dirs(folder: Path) -> list[Path]:
    """The folders of runs that left neither a record nor an error, sorted: they were killed, or are
    still running."""
    _, names = _content(folder / RUN_FOLDERS)
    begun = (folder / RUN_FOLDERS / name for name in sorted(names) if not name.startswith("."))
    return [path for path in begun if not run_dirs(path)]


def _content(folder: Path) -> tuple[set[str], list[str]]:
    """All names in a folder, and those of folders; nothing if it cannot be read, or is none.

    Raises UserError for runs that cannot be read, of which a report must not be silent.
    """
    try:
        with os.scandir(folder) as entries:
            kinds = {entry.name: entry.is_dir(follow_symlinks=False) for entry in entries}
    except OSError as error:
        if isinstance(error, PermissionError) and RUN_FOLDERS in (folder.name, folder.parent.name):
            raise UserError(os_line(error, folder)) from error
        return set(), []
    return set(kinds), [name for name, is_folder in kinds.items() if is_folder]
