"""Facts that a reader must know about the runs of a study before trusting the numbers; the template
`notes.jinja` words them."""

import math
import os
import re
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

from framework.errors import UserError, printable_line
from framework.records.record import EXPOSURE, FAILED, LEARNED, read_failure
from framework.report.study.methods import Method
from framework.report.study.study import ReportRun, Study
from framework.report.study.words import code, outside

NUMBER = re.compile(r"(?<![\w.,/=-])(\d+(?:\.\d+)?)(?![\w.,/-]*\w)")  # not part of a name

K = TypeVar("K")
Runs = Sequence[ReportRun]


def grouped(runs: Runs, key: Callable[[ReportRun], K]) -> dict[K, list[ReportRun]]:
    groups: dict[K, list[ReportRun]] = defaultdict(list)
    for run in runs:
        groups[key(run)].append(run)
    return groups


def warnings(study: Study) -> dict[str, list[ReportRun]]:
    """Every distinct warning with the runs that gave it. Those that differ in numbers alone are
    one, with the range of each number."""
    gave: dict[tuple[str, ...], list[tuple[list[str], ReportRun]]] = defaultdict(list)
    for run in study.runs:
        for text in run.record.warnings:
            parts = NUMBER.split(outside(text))
            gave[tuple(parts[::2])].append((parts[1::2], run))
    return {
        _ranged(words, group): list({id(run): run for _, run in group}.values())
        for words, group in gave.items()
    }


def _ranged(words: Sequence[str], group: Sequence[tuple[list[str], ReportRun]]) -> str:
    """The text with the range of each number in between the words."""
    text = words[0]
    numbers = zip(*(numbers for numbers, _ in group), strict=True)
    for values, following in zip(numbers, words[1:], strict=True):
        low, high = min(values, key=float), max(values, key=float)
        text += (low if low == high else f"{low} to {high}") + following
    return text


def failed_repetitions(study: Study) -> list[tuple[str, str]]:
    """(folder, error) of complete runs whose repetition failed."""
    failed = []
    for folder in (run.run.run_dir for run in study.runs):
        if os.path.lexists(folder / FAILED):
            try:
                error = read_failure(folder).error
            except UserError as damage:
                error = str(damage).replace(printable_line(f"{folder}/"), "")
            failed.append((folder.name, outside(error)))
    return failed


def identical(study: Study) -> dict[tuple[Method, ...], dict[str, list[int]]]:
    """Methods that produced identical parameters -> scene -> seeds."""
    cells = grouped(study.runs, lambda r: (r.scene, r.seed, r.record.parameters_sha256))
    alike: dict[tuple[Method, ...], dict[str, list[int]]] = defaultdict(lambda: defaultdict(list))
    for (scene, seed, digest), group in cells.items():
        if digest and len(group) > 1:
            alike[tuple(run.method for run in group)][scene].append(seed)
    return alike


def constant(study: Study) -> dict[str, list[Method]]:
    """Scene -> methods whose PSNR is identical for every seed."""
    methods_by_scene: dict[str, list[Method]] = defaultdict(list)
    for (scene, method), group in grouped(study.runs, lambda r: (r.scene, r.method)).items():
        values = {run.mean("psnr") for run in group}
        if len(group) > 1 and len(values) == 1 and None not in values:
            methods_by_scene[scene].append(method)
    return methods_by_scene


def code_versions(sources: Sequence[Mapping[str, Any]]) -> dict[str, int]:
    """Name -> number of versions of the code, or of a plugin, if there are several."""
    versions = defaultdict[str, set[str]](set)
    for p in sources:
        versions["the code"].add(str(p.get("code") or p.get("git")))
        for name, digest in (p.get("plugins") or {}).items():
            versions[code(name)].add(digest)
    return {name: len(digests) for name, digests in versions.items() if len(digests) > 1}


def machines(study: Study) -> tuple[list[str], dict[str, list[ReportRun]]]:
    """The scenes with runs of different machines, and their runs by machine."""
    by_scene = grouped(study.runs, lambda run: run.scene)
    scenes = [s for s, group in by_scene.items() if len({run.machine for run in group}) > 1]
    return scenes, grouped([r for r in study.runs if r.scene in scenes], lambda run: run.machine)


def learned(study: Study) -> dict[str, list[Method]]:
    """Weights of networks that were trained on other scenes -> the methods that used them."""
    with_weights = grouped(study.runs, lambda run: str(run.record.provenance.get(LEARNED) or ""))
    return {
        outside(weights): list(dict.fromkeys(run.method for run in runs))
        for weights, runs in with_weights.items()
        if weights
    }


def exposures(study: Study) -> list[tuple[str, list[float]]]:
    """The scenes whose photos were exposed differently, and by how many percent, root mean square,
    in those of their runs."""
    scenes = []
    for scene in sorted(study.scenes):
        sizes = [run.record.provenance.get(EXPOSURE) for run in study.of(scene)]
        percent = [100 * s for s in sizes if isinstance(s, int | float) and math.isfinite(s)]
        if percent:
            scenes.append((scene, sorted(percent)))
    return scenes


def shared_errors(study: Study) -> list[str]:
    """What was made wrong on purpose, by the same random draw for all seeds: depth, poses."""
    configs = [run.record.config for run in study.runs]
    depths = [c.get("depth") or {} for c in configs]
    wrong = [d for d in depths if d.get("strength") and d.get("corruption", "none") != "none"]
    seeds = {d.get("corruption_seed") for d in wrong}
    noisy = any((c.get("scene") or {}).get("pose_noise") for c in configs)
    return (["depth"] if len(seeds) == 1 else []) + (["poses"] if noisy else [])


def without_psnr(study: Study) -> dict[Method, int]:
    """Method -> number of its runs on tested scenes without a finite PSNR."""
    tested = [run for scene in study.tested for run in study.of(scene)]
    lacking = [run for run in tested if run.mean("psnr") is None]
    return {method: len(runs) for method, runs in grouped(lacking, lambda r: r.method).items()}


def untested(study: Study) -> list[str]:
    """Scenes without test views, where others have some."""
    return [s for s in study.scenes if s not in study.tested] if study.tested else []


def partial(study: Study) -> list[Method]:
    """Methods that were not tested on every scene."""
    on = {m: {run.scene for run in study.of(method=m) if run.tested} for m in study.methods}
    return [method for method, scenes in on.items() if len(scenes) < len(study.tested)]
