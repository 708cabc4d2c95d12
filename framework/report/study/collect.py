"""The runs of one or more studies, each with the name of its method and of its scene."""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain, product
from pathlib import Path
from types import MappingProxyType
from typing import Any

from framework.errors import UserError, printable_line, require
from framework.files.limits import RUNS
from framework.metrics.values import Missing
from framework.records.failure import FAILED, read_failure
from framework.records.record import RECORD, Run, RunRecord, read_run
from framework.records.search import Searched, read_search
from framework.report.study.axes import Axis
from framework.report.study.folders import RUN_FOLDERS, run_dirs
from framework.report.study.labels import (
    MethodLabel,
    SceneLabel,
    code,
    listed,
    method_labels,
    outside,
    scene_labels,
)
from framework.report.study.order import BASELINE, method_order, natural
from framework.report.study.recipes import NOTE, by_recipe
from framework.report.study.shorten import shortened
from framework.report.study.tabled import TABLE, TOLD, is_tabled, read_tabled

DAMAGED = "damaged"  # the kind of failure of a folder that no run left
BUSY = 1.3  # wall seconds per CPU second of a training from which others shared its cores


@dataclass(frozen=True)
class ReportRun:
    """A complete run with the labels it has in this study."""

    run: Run
    method_label: MethodLabel
    scene_label: SceneLabel

    @property
    def method(self) -> str:
        return self.method_label.full

    @property
    def scene(self) -> str:
        return self.scene_label.full

    @property
    def record(self) -> RunRecord:
        return self.run.record

    @property
    def seed(self) -> int:
        return self.run.record.seed

    def mean(self, metric: str) -> float | None:
        """Mean of a metric over the test views; None where it is missing."""
        value = self.record.summary.get(metric, Missing("not measured"))
        return None if isinstance(value, Missing) else float(value)

    @property
    def tested(self) -> bool:
        """Whether there were test views."""
        return len(self.files) > 0 or self.mean("psnr") is not None

    @cached_property
    def files(self) -> dict[str, str]:
        """View -> first part of the names of its image files."""
        texts = self.run.metrics.texts
        return dict(zip(texts["view"], texts["file"], strict=True))

    @cached_property
    def psnr(self) -> dict[str, float]:
        """View -> PSNR in dB, NaN where it is infinite."""
        table = self.run.metrics
        return dict(zip(table.texts["view"], table.numbers["psnr"].tolist(), strict=True))

    def level(self, axis: Axis) -> float | None:
        """The strength of a stress; None where the run's options do not have it as a number."""
        value = self.scene_label.data.get(axis.key)
        return float(value) if isinstance(value, int | float) else None


@dataclass(frozen=True)
class FailedRun:
    """A run that ended with an error. kind: of it, a word or two, "" where that was not kept.
    method, scene: "" where it left no configuration."""

    run_dir: Path
    error: str
    kind: str
    overrides: tuple[str, ...]
    config: Mapping[str, Any]
    provenance: Mapping[str, Any]
    method: str = ""
    scene: str = ""

    @property
    def seed(self) -> int | None:
        return int(self.config["seed"]) if "seed" in self.config else None


@dataclass(frozen=True)
class Study:
    """out_dir: where the report goes. runs: complete, sorted by scene, method, seed. notes: what a
    reader must be told. missing: (scene, method, seed) that a full cross would have. linked:
    whether the folders of the runs can be reached from the report. tabled: folders of which only
    the table of runs is there. searched: the trials, where the runs are those of a search."""

    out_dir: Path
    runs: tuple[ReportRun, ...]
    failed: tuple[FailedRun, ...]
    notes: tuple[str, ...]
    missing: tuple[tuple[str, str, int], ...] = ()
    linked: bool = True
    tabled: tuple[Path, ...] = ()
    searched: Searched | None = None

    @cached_property
    def scenes(self) -> list[str]:
        """Scene labels, sorted."""
        return sorted({run.scene for run in self.runs}, key=natural)

    @cached_property
    def tested(self) -> list[str]:
        """The scenes, sorted, of which some run had test views."""
        return sorted({run.scene for run in self.runs if run.tested}, key=natural)

    @cached_property
    def methods(self) -> list[str]:
        """Method labels: the baseline first, then by name."""
        return sorted({run.method for run in self.runs}, key=method_order)

    @property
    def tried(self) -> list[str]:
        """`methods` and those of which every run failed."""
        names = {run.method for run in self.runs} | {run.method for run in self.failed}
        return sorted(names - {""}, key=method_order)

    @cached_property
    def families(self) -> list[str]:
        """Method labels without budgets, in the order of `methods`."""
        return sorted({run.method_label.family for run in self.runs}, key=method_order)

    @property
    def baseline(self) -> str:
        """What the others are compared with: `none + none` if it ran, else the first by name."""
        return self.methods[0]

    @cached_property
    def by_cpu(self) -> bool:
        """Whether to compare the CPU seconds of trainings: other programs ran beside some."""
        return any(map(_disturbed, self.runs))

    @property
    def has_plain(self) -> bool:
        """Whether the baseline is `none + none`, perhaps with options of its own."""
        return bool(self.runs) and self.baseline.startswith(BASELINE)

    def baseline_of(self, method: str) -> str:
        """The baseline with the budget and, for another method, the other options of `method`, as
        far as there is one; else the study's."""
        if len(self.families) < 2:
            return self.baseline
        labels = {run.method: run.method_label for run in self.runs}
        own = labels.get(method, MethodLabel(method))
        equal = [m for m in self.methods if labels[m].budget == own.budget]
        plain = labels[self.baseline].pair
        alike = [m for m in equal if (labels[m].pair, labels[m].options) == (plain, own.options)]
        if own.pair != plain and alike:
            return alike[0]
        return equal[0] if equal else self.baseline

    def of(self, scene: str | None = None, method: str | None = None) -> list[ReportRun]:
        """The runs of a scene and method (None = any), by seed."""
        return [
            run for run in self.runs if scene in (None, run.scene) and method in (None, run.method)
        ]

    def name_of(self, scene: str) -> str:
        """The name in its record of a scene with this label."""
        return next(run.scene_label.name for run in self.runs if run.scene == scene)

    def folder_of(self, run_dir: Path) -> str:
        """`run_dir` as seen from the report."""
        return Path(os.path.relpath(run_dir.resolve(), self.out_dir.resolve())).as_posix()


def collect(
    study_dirs: Path | Sequence[Path],
    out_dir: Path | None = None,
    broken: Mapping[Path, str] = MappingProxyType({}),
) -> Study:
    """Read every record below the folders. out_dir: where the report goes, else the first folder.
    broken: folders of runs that turned out damaged, and why.

    A folder without runs is read from its table (`framework.report.study.tabled`). Raises UserError
    if a folder has neither.
    """
    folders = [study_dirs] if isinstance(study_dirs, Path) else list(study_dirs)
    runs, failed, origins, told, tabled = _gathered(folders, broken)
    labelled, named = _label(runs, failed)
    missing = _missing(labelled, named, origins)
    short, shortened_notes = shortened([run.method_label for run in (*labelled, *told)])
    recipes = by_recipe([(run.method_label, run.record.overrides) for run in labelled])
    if recipes and not told:
        short, shortened_notes = recipes, [NOTE]
    labelled, told = (
        [replace(run, method_label=short[run.method]) for run in some] for some in (labelled, told)
    )
    named = [replace(run, method=_short(short, run.method)) for run in named]
    missing = [(scene, _short(short, method), seed) for scene, method, seed in missing]
    unique, repeated = _without_repeats([*labelled, *told])
    unique.sort(key=lambda r: (natural(r.scene), method_order(r.method), r.seed))
    searched = read_search(folders[0]) if len(folders) == 1 else None
    if searched is not None:
        missing = []  # no full cross: each trial is a method of its own
    notes = chain(
        _table_notes(told),
        shortened_notes,
        repeated,
        _repeat_notes(unique),
        _equal_notes(unique),
        _code_notes(runs),
        _busy_notes(unique),
    )
    return Study(
        out_dir or folders[0],
        tuple(unique),
        tuple(named),
        tuple(notes),
        tuple(missing),
        linked=not tabled,
        tabled=tuple(tabled),
        searched=searched,
    )


def _gathered(
    folders: Sequence[Path], broken: Mapping[Path, str]
) -> tuple[list[Run], list[FailedRun], list[Path], list[ReportRun], list[Path]]:
    """Complete runs, failed ones, the folder that each complete one is of; what is told of those
    that are in a table alone, and the folders of such tables."""
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
    return runs, failed, origins, told, tabled


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
            failed.append(FailedRun(path, _within(path, error), DAMAGED, (), {}, {}))
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
        return FailedRun(path, left.error, left.kind, left.overrides, left.config, {})
    run = read_run(path)
    record = run.record
    if record.status == "complete":
        return run
    kind = read_failure(path).kind if os.path.lexists(path / FAILED) else ""
    error = record.error or "not told"
    return FailedRun(path, error, kind, record.overrides, record.config, record.provenance)


def _within(path: Path, error: UserError) -> str:
    """The error, which tells the folder `path` and its files without the way to it."""
    below = str(error).replace(printable_line(f"{path}/"), "")
    return below.replace(printable_line(f"{path}:"), printable_line(f"{path.name}:"))


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
    runs: Sequence[ReportRun], failed: Sequence[FailedRun], origins: Sequence[Path]
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
    """One run per scene, method and seed: the first by folder; the others are told."""
    kept: dict[tuple[str, str, int], ReportRun] = {}
    notes = []
    for run in runs:
        first = kept.setdefault((run.scene, run.method, run.seed), run)
        if first is not run:
            notes.append(
                f"{run.method} on {run.scene} with seed {run.seed} was found twice; the run in"
                f" {code(run.run.run_dir.name)} is left out in favour of"
                f" {code(first.run.run_dir.name)}."
            )
    return list(kept.values()), notes


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
        return _within(folder, error)


def _equal_notes(runs: Sequence[ReportRun]) -> list[str]:
    """Methods that trained to the same bits: a test of their difference would be of nothing."""
    cells: dict[tuple[str, int, str], list[str]] = defaultdict(list)
    for run in runs:
        cells[run.scene, run.seed, run.record.parameters_sha256].append(run.method)
    found: dict[tuple[str, ...], dict[str, list[int]]] = defaultdict(lambda: defaultdict(list))
    for (scene, seed, bits), methods in cells.items():
        if bits and len(methods) > 1:
            found[tuple(methods)][scene].append(seed)
    notes = []
    for alike, scenes in found.items():
        where = "; ".join(f"{scene}, {_seeds(seeds)}" for scene, seeds in scenes.items())
        notes.append(
            f"{listed(alike, 'and')} trained to the same bits ({where}): what tells them apart"
            " never took effect there, so nothing was learned about it."
        )
    return notes


def _seeds(seeds: Sequence[int]) -> str:
    return f"seed{'s' if len(seeds) > 1 else ''} {listed(seeds, 'and')}"


def _table_notes(runs: Sequence[ReportRun]) -> list[str]:
    """What a report from a table does not know, and of which code its runs are."""
    if not runs:
        return []
    told = [str(run.record.provenance[TOLD]).split(" or ") for run in runs]
    codes = sorted({*chain(*told)} - {""})
    made = "one version" if len(codes) == 1 else f"{len(codes)} versions"
    of = (
        f" The runs were made by {made} of the code ({', '.join(codes)}); today's defaults may"
        " differ from theirs."
        if codes
        else ""
    )
    return [
        f"Built from the table `{TABLE}` alone, as the folders of the runs were not kept: nothing"
        " is said about single views, the course of a training or failed runs, and the pictures"
        f" are those that were drawn when the runs were made.{of}"
    ]


def _code_notes(runs: list[Run]) -> list[str]:
    versions = {str(run.record.provenance.get("code")) for run in runs}
    if len(versions) < 2:
        return []
    return [
        f"The runs were made with {len(versions)} versions of the code, which may explain a"
        " difference; the study's command repeats the outdated ones."
    ]


def _busy_notes(runs: Sequence[ReportRun]) -> list[str]:
    """A training alone on its cores takes no more wall time than CPU time."""
    slowed = sum(map(_disturbed, runs))
    if slowed == 0:
        return []
    return [
        f"While {slowed} of {len(runs)} trainings ran, other programs used the processor too (the"
        f" clock showed over {BUSY:g} times the CPU time). Charts of cost and the advice by time"
        " therefore count CPU seconds; tables give both; curves over time go by the clock."
    ]


def _disturbed(run: ReportRun) -> bool:
    wall, cpu = run.record.train_s or 0.0, run.record.train_cpu_s or 0.0
    return wall > BUSY * cpu > 0
