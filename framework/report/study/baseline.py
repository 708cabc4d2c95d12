"""The commands that add plain training to a study that lacks it."""

import os
from collections.abc import Sequence
from itertools import product

from framework.files.program import command_line
from framework.records import RUN_FOLDERS
from framework.report.study.methods import PLAIN
from framework.report.study.study import ReportRun, Study

METHOD_WORDS = ("method", "augment", "reg", "seed", "study")  # that the command replaces
Words = tuple[str, ...]


def baseline_commands(study: Study) -> list[str]:
    """The commands, from the command lines of those runs for which no plain training has the same
    scene and budget.

    It is a single one if one sweep does them all. Runs in a folder of the user's choice have none.
    """
    if any(run.run.run_dir.parent.name != RUN_FOLDERS for run in study.runs):
        return []
    plain = [run for run in study.runs if run.method.pair == PLAIN]
    there = {(run.scene, run.method.budget) for run in plain}
    tried = {_kept(run) for run in plain}  # whose budget is the method's own, as of a recipe
    seeds: dict[Words, set[int]] = {}
    for run in study.runs:
        if (run.scene, run.method.budget) not in there and _kept(run) not in tried:
            seeds.setdefault(_kept(run), set()).add(run.seed)
    if not seeds:
        return []
    folder = _study_words(study)
    joined = _joined(list(seeds)) if len({*map(frozenset, seeds.values())}) == 1 else None
    groups = {joined: seeds[min(seeds)]} if joined else seeds
    return [
        command_line(
            ["method=baseline", *words, f"seed={','.join(map(str, sorted(of)))}", *folder, "-m"]
        )
        for words, of in groups.items()
    ]


def _kept(run: ReportRun) -> Words:
    """The words of its command line that do not choose method, seed or study."""
    words = [word.lstrip("+") for word in run.record.overrides]
    return tuple(w for w in words if w.partition("=")[0].partition(".")[0] not in METHOD_WORDS)


def _joined(lines: Sequence[Words]) -> Words | None:
    """The words of one sweep over all lines; None if it would also do others."""
    keys = [word.partition("=")[0] for word in lines[0]]
    if any([word.partition("=")[0] for word in line] != keys for line in lines):
        return None
    columns = zip(*lines, strict=True)
    values = [list(dict.fromkeys(word.partition("=")[2] for word in row)) for row in columns]
    every = {
        tuple(f"{key}={value}" for key, value in zip(keys, combination, strict=True))
        for combination in product(*values)
    }
    if every != set(lines):
        return None
    return tuple(f"{key}={','.join(of)}" for key, of in zip(keys, values, strict=True))


def _study_words(study: Study) -> list[str]:
    """The words that lead to the study's folder, which may lie deeper or elsewhere."""
    folder = study.runs[0].run.run_dir.parent.parent.resolve()
    words = [word.lstrip("+") for run in study.runs for word in run.record.overrides]
    names = [word.removeprefix("study=") for word in words if word.startswith("study=")]
    name = next((n for n in names if folder.as_posix().endswith(f"/{n}")), folder.name)
    place = folder.parents[name.count("/")]
    usual = study.archived or place.name == "reports"
    return [f"study={name}", *([] if usual else [f"hydra.sweep.dir={os.path.relpath(place)}"])]
