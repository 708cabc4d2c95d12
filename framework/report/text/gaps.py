"""What a study lacks: failed and missing runs, methods that are not on every scene, metrics that
were not measured. A note on the first screen counts them, sections below list them."""

from __future__ import annotations

import shlex
from collections import defaultdict

from framework.metrics.values import METRICS, NOT_REQUESTED, Missing
from framework.report.parts.document import Block, Bullets, Heading, Text, table
from framework.report.study.labels import code, joined, listed, outside
from framework.report.study.names import NAMES, own_metrics
from framework.report.study.runs import DAMAGED, FailedRun, Study
from framework.report.text import searched
from framework.scenes import HELD_OUT

WORDS = ("Run", "Kind", "Reason", "Again")


def gap_notes(study: Study, pooled: bool = True) -> list[Block]:
    """For the first screen: how many runs failed or are missing, and which methods the comparison
    over all scenes leaves out. pooled: whether there is such a comparison."""
    counts = []
    if study.failed:
        counts.append(f"{len(study.failed)} of {len(study.runs) + len(study.failed)} runs failed")
    if study.missing:
        counts.append(f"{_runs(len(study.missing))} missing")
    texts = [f"{' and '.join(counts)}: listed below."] if counts else []
    unfinished = sorted(set(study.tried) - set(study.methods))
    if unfinished:
        texts.append(f"No run finished of {joined(unfinished)}.")
    untested = [scene for scene in study.scenes if scene not in study.tested]
    if untested and study.tested:
        texts.append(f"Not tested (scene.split=none), hence not compared: {joined(untested)}.")
    everywhere = len(study.tested) if pooled else 0
    on = {m: {run.scene for run in study.of(method=m) if run.tested} for m in study.methods}
    partial = [method for method, scenes in on.items() if len(scenes) < everywhere]
    if partial:
        texts.append(
            f"Not on every scene, hence left out of the mean over scenes: {joined(partial)}."
        )
    if any(run.protocol.endswith(HELD_OUT) for run in study.runs):
        texts.append(searched.HELD_OUT)
    if study.rival and study.searched is None:
        bases = study.baselines
        told = f"As `--baseline` asks, methods are compared with {bases[0]}"
        if len(bases) > 1:
            told += f"; where budget or options are others, with {listed(bases[1:], 'and')}"
        texts.append(f"{told}.")
    elif study.searched is None and len(study.methods) > 1 and not study.has_plain:
        texts.append(f"No run of `none + none`: the others are compared with {study.baseline}.")
    if study.searched is None and study.without_baseline:
        alone = joined(study.without_baseline)
        texts.append(f"No baseline has their budget, hence compared with nothing: {alone}.")
    return [Text(text, "note") for text in (*texts, *study.notes)]


def failures(study: Study) -> list[Block]:
    """Every failed run with its kind and reason, and the command that does it again."""
    if not study.failed:
        return []
    rows = [
        {
            "Run": code(study.folder_of(run.run_dir)),
            "Kind": outside(run.kind),
            "Reason": outside(run.error),
            "Again": "" if run.kind == DAMAGED else _again(run),
        }
        for run in study.failed
    ]
    text = "The study's command does them again; the command in the last column does one alone."
    return [Heading(2, "Failed runs"), Text(text), table(rows, WORDS)]


def _again(run: FailedRun) -> str:
    return code(run.again or shlex.join(["python", "run.py", *run.overrides, "-m"]))


def missing_runs(study: Study) -> list[Block]:
    """The cells of the cross that nothing was found for."""
    if not study.missing:
        return []
    seeds: dict[tuple[str, str], list[str]] = defaultdict(list)
    for scene, method, seed in study.missing:
        seeds[scene, method].append(str(seed))
    items = [f"{method} on {scene}: seed {', '.join(s)}" for (scene, method), s in seeds.items()]
    text = (
        f"For every method on every scene with every seed of its study, {_runs(len(study.missing))}"
        " missing:"
    )
    return [Heading(2, "Missing runs"), Text(text), Bullets(tuple(items))]


def missing_metrics(study: Study) -> list[Block]:
    """Each missing metric once per reason, with the number of runs it concerns."""
    counts: dict[tuple[str, str], int] = defaultdict(int)
    for run in study.runs:
        for metric in (*METRICS, *own_metrics(study)):
            value = run.record.summary.get(metric)
            if isinstance(value, Missing) and value != NOT_REQUESTED:
                counts[NAMES.get(metric, outside(metric)), outside(value.reason)] += 1
    lines = [
        f"{metric}: missing in {n} of {len(study.runs)} runs: {reason}"
        for (metric, reason), n in sorted(counts.items())
    ]
    return [Heading(2, "Missing metrics"), Bullets(tuple(lines))] if lines else []


def _runs(n: int) -> str:
    return "1 run is" if n == 1 else f"{n} runs are"
