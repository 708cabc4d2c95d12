"""What a reader must know about the runs of a study before trusting the numbers."""

from __future__ import annotations

import math
import os
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from framework.errors import UserError, printable_line
from framework.records.archive import ARCHIVE
from framework.records.failure import FAILED, read_failure
from framework.records.record import EXPOSURE, Run
from framework.report.study.study import BUSY, ReportRun, Study
from framework.report.study.words import code, joined, listed, outside
from framework.scenes import HELD_OUT

MOST_NAMED = 5
MOST_WARNINGS = 10


def notes(unique: Sequence[ReportRun], runs: Sequence[Run]) -> list[str]:
    """Notes on `unique`, the runs that are reported, and `runs`, all complete ones."""
    return [
        *_warning_notes(unique),
        *_repeat_notes(unique),
        *_equal_notes(unique),
        *_constant_notes(unique),
        *_code_notes(runs),
        *_machine_notes(unique),
        *_busy_notes(unique),
        *_exposure_notes(unique),
    ]


def archive_notes(folders: Sequence[Path]) -> list[str]:
    """Why a report of an archive has no pictures."""
    text = f"Made from {code(ARCHIVE)}, as the folders of the runs were not kept: no pictures."
    return [text] if folders else []


def begun_notes(names: Sequence[str]) -> list[str]:
    """Runs, by the names of their folders, that left neither a result nor an error."""
    if not names:
        return []
    start = "1 run was begun and has" if len(names) == 1 else f"{len(names)} runs were begun, with"
    return [
        f"{start} no result: still running, or killed ({_first([*map(code, names)])}). The study's"
        " command continues what was killed."
    ]


def within(path: Path, error: UserError) -> str:
    """The error, with the folder `path` and its files named without the path to it."""
    below = str(error).replace(printable_line(f"{path}/"), "")
    return below.replace(printable_line(f"{path}:"), printable_line(f"{path.name}:"))


def _first(names: Sequence[object]) -> str:
    """The names, the first `MOST_NAMED` of many."""
    more = [f"{len(names) - MOST_NAMED} more"] if len(names) > MOST_NAMED else []
    return listed([*names[:MOST_NAMED], *more])


def _grouped(runs: Sequence[ReportRun], key: Callable[[ReportRun], Any]) -> dict[Any, list[Any]]:
    groups: dict[Any, list[Any]] = defaultdict(list)
    for run in runs:
        groups[key(run)].append(run)
    return groups


def _warning_notes(runs: Sequence[ReportRun]) -> list[str]:
    """Every distinct warning of the runs, with the scenes and the number of runs that gave it."""
    gave: dict[str, list[ReportRun]] = defaultdict(list)
    for run in runs:
        for text in run.record.warnings:
            gave[text].append(run)
    warned = []
    for text, those in gave.items():
        scenes = listed(sorted({run.scene for run in those}))
        share = "" if len(those) == len(runs) else f", {len(those)} of {len(runs)} runs"
        warned.append(f"Warning ({scenes}{share}): {outside(text)}")
    if len(warned) <= MOST_WARNINGS:
        return warned
    more = len(warned) - MOST_WARNINGS
    return [*warned[:MOST_WARNINGS], f"{more} more warnings are in the runs' record.json."]


def _repeat_notes(runs: Sequence[ReportRun]) -> list[str]:
    """Complete runs whose repetition failed."""
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
    """Methods that produced identical parameters, so that a test compares nothing."""
    cells = _grouped(runs, lambda r: (r.scene, r.seed, r.record.parameters_sha256))
    alike: dict[tuple[Any, ...], dict[str, list[int]]] = defaultdict(lambda: defaultdict(list))
    for (scene, seed, digest), group in cells.items():
        if digest and len(group) > 1:
            alike[tuple(run.method for run in group)][scene].append(seed)
    texts = []
    for methods, scenes in alike.items():
        where = "; ".join(
            f"{scene}, seed{'s' if len(seeds) > 1 else ''} {listed(seeds)}"
            for scene, seeds in scenes.items()
        )
        texts.append(
            f"{listed(methods)} produced identical parameters ({where}), so the option that"
            " distinguishes them had no effect there."
        )
    return texts


def _constant_notes(runs: Sequence[ReportRun]) -> list[str]:
    """Methods whose PSNR is identical for every seed, so that its interval has zero width."""
    found: dict[str, list[object]] = defaultdict(list)
    for (scene, method), group in _grouped(runs, lambda r: (r.scene, r.method)).items():
        values = {run.mean("psnr") for run in group}
        if len(group) > 1 and len(values) == 1 and None not in values:
            found[scene].append(method)
    if not found:
        return []
    where = "; ".join(f"{_few(methods)} on {scene}" for scene, methods in found.items())
    return [
        f"The same PSNR with every seed: {where}. Intervals over these seeds have zero width and"
        " mean nothing."
    ]


def _few(methods: Sequence[object]) -> str:
    return listed(methods) if len(methods) <= MOST_NAMED else f"{len(methods)} methods"


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
    """Whether `code` includes the user's plugins."""
    return "own_plugins" in source and "plugins" not in source and bool(_commit(source))


def _machine_notes(runs: Sequence[ReportRun]) -> list[str]:
    """Seconds of different machines do not compare methods."""
    by_scene = _grouped(runs, lambda run: run.scene)
    scenes = [s for s, group in by_scene.items() if len({run.machine for run in group}) > 1]
    if not scenes:
        return []
    groups = _grouped([run for run in runs if run.scene in scenes], lambda run: run.machine)
    machines = "; ".join(
        f"{name}: {len(group)} run{'s' if len(group) > 1 else ''} of"
        f" {_few(list(dict.fromkeys(run.method for run in group)))}"
        for name, group in groups.items()
    )
    return [
        f"Runs of {listed(scenes)} were made on different machines ({machines}): their seconds do"
        " not compare, so there is no advice by time."
    ]


def _busy_notes(runs: Sequence[ReportRun]) -> list[str]:
    """A training alone on its cores takes no more wall time than CPU time."""
    slowed = sum(run.disturbed for run in runs)
    if slowed == 0:
        return []
    return [
        f"Other programs used the processor during {slowed} of {len(runs)} trainings (wall time"
        f" over {BUSY:g} times the CPU time). Charts of cost and advice by time therefore use CPU"
        " seconds; tables give both; curves over time use wall time."
    ]


def _exposure_notes(runs: Sequence[ReportRun]) -> list[str]:
    """Scenes whose photos were exposed differently, and by how much."""
    texts = []
    for scene, group in sorted(_grouped(runs, lambda run: run.scene).items()):
        sizes = [run.record.provenance.get(EXPOSURE) for run in group]
        percent = [100 * s for s in sizes if isinstance(s, int | float) and math.isfinite(s)]
        if percent:
            ends = dict.fromkeys(f"{end:.0f}" for end in (min(percent), max(percent)))
            share = "" if len(percent) == len(group) else f" in {len(percent)} of {len(group)} runs"
            texts.append(f"{scene} by {' to '.join(ends)} %{share}")
    if not texts:
        return []
    return [
        f"Photos were exposed differently ({listed(texts)}, root mean square). They were equalized"
        " before training, and test views are rendered as the photos around them were exposed"
        " (trainer.exposure)."
    ]


def gap_notes(study: Study, pooled: bool) -> list[str]:
    """Which runs failed or are missing, and which methods a comparison leaves out. pooled: whether
    the report compares means over all scenes."""
    counts = []
    if study.failed:
        counts.append(f"{len(study.failed)} of {len(study.runs) + len(study.failed)} runs failed")
    if study.missing:
        n = len(study.missing)
        counts.append(f"{n} run{' is' if n == 1 else 's are'} missing")
    texts = [f"{' and '.join(counts)}: listed below."] if counts else []
    unfinished = [method for method in study.tried if method not in study.methods]
    if unfinished:
        texts.append(f"No run finished of {joined(unfinished)}.")
    untested = [scene for scene in study.scenes if scene not in study.tested]
    if untested and study.tested:
        texts.append(f"Not tested (scene.split=none), so not compared: {joined(untested)}.")
    on = {m: {run.scene for run in study.of(method=m) if run.tested} for m in study.methods}
    everywhere = len(study.tested) if pooled and study.searched is None else 0
    partial = [method for method, scenes in on.items() if len(scenes) < everywhere]
    if partial:
        texts.append(f"Not on every scene, so not in the mean over scenes: {joined(partial)}.")
    if any(run.protocol.endswith(HELD_OUT) for run in study.runs):
        texts.append(
            "Evaluated on training views that were held out (a split whose name ends in _held_out):"
            " no test view was used. These numbers choose options; they are not results."
        )
    return texts if study.searched is not None else [*texts, *_baseline_notes(study)]


def _baseline_notes(study: Study) -> list[str]:
    """What methods are compared with, if that is not plain training."""
    texts = []
    if study.rival:
        bases = study.baselines
        text = f"As `--baseline` asks, methods are compared with {bases[0]}"
        if len(bases) > 1:
            text += f"; with other budgets or options, with {listed(bases[1:])}"
        texts.append(f"{text}.")
    elif len(study.methods) > 1 and not study.has_plain:
        texts.append(f"No run of plain training: the others are compared with {study.baseline}.")
    if study.without_baseline:
        alone = joined(study.without_baseline)
        texts.append(f"No baseline has their budget, so compared with nothing: {alone}.")
    return texts
