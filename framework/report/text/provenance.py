"""Where a report's numbers come from: code, packages, machine, scenes, commands, time."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any

from framework.compute.stopwatch import duration
from framework.records.provenance import BITS
from framework.report.parts.document import Block, Bullets, Heading, Text
from framework.report.study.labels import code, outside
from framework.report.study.runs import Study

SHOWN_VIEWS = 12
WITHOUT_BITS = (
    "Runs on a GPU add up in no fixed order: given again, the same command with the same seed ends"
    ' with slightly other numbers, in the record told as "bits: not kept by this rasterizer".'
    " A part of the spread over seeds is that of repetition (docs/rasterizers.md)."
)


def provenance_blocks(study: Study) -> list[Block]:
    """The last section of a report."""
    sources = [run.record.provenance for run in study.runs]
    sources += [run.provenance for run in study.failed if run.provenance]
    facts = {name: values for name, values in _facts(sources).items() if values}
    lines = [f"{name}: {'; '.join(values)}" for name, values in facts.items()]
    blocks: list[Block] = [Heading(2, "Provenance"), Bullets((*lines, *_runs(study)))]
    scenes = _scenes(study)
    if scenes:
        blocks += [Text("Scenes:"), Bullets(tuple(scenes))]
    if any(BITS in told for told in sources):
        blocks.append(Text(WITHOUT_BITS))
    return [*blocks, Text("Overrides on the command line:"), Bullets(tuple(_commands(study)))]


def _facts(sources: Sequence[Mapping[str, Any]]) -> dict[str, list[str]]:
    """Each fact of provenance with all the distinct values it has among the runs."""
    facts = {
        "Code": [_code(p) for p in sources],
        "Plugins": [_plugins(p.get("plugins") or {}) for p in sources],
        "fishersplat": [outside(str(p.get("fishersplat"))) for p in sources],
        "Python": [outside(str(p.get("python"))) for p in sources],
        "Packages": [_packages(p.get("packages") or {}) for p in sources],
        "CPU": [outside(f"{p['cpu']}, {p.get('cores')} cores") for p in sources if "cpu" in p],
        "Threads": [outside(str(p.get("threads"))) for p in sources],
        "System": [outside(str(p.get("system"))) for p in sources],
        "GPU": [_gpu(p) for p in sources if p.get("gpu")],
        "Bits": [outside(str(p[BITS])) for p in sources if BITS in p],
    }
    return {name: sorted(set(values) - {"", "None"}) for name, values in facts.items()}


def code_of(source: Mapping[str, Any]) -> str:
    """Of which code a run is, for a table: `git 80cf492d6c with local changes`."""
    state = source.get("git")
    if not state:
        return f"sources {outside(str(source.get('code'))[:12])}"
    return f"git {outside(str(state['sha'])[:10])}{' with local changes' if state['dirty'] else ''}"


def _code(source: Mapping[str, Any]) -> str:
    return f"{_git(source.get('git'))}, sources {code(str(source.get('code'))[:12])}"


def _runs(study: Study) -> list[str]:
    """Where each run is told, and what all took, one after another."""
    if not study.runs:
        return []
    stages = [stage for run in study.runs for stage in run.record.timings.values()]
    wall, cpu = sum(stage.wall_s for stage in stages), sum(stage.cpu_s for stage in stages)
    row = "Every run in a row, with its options and figures: `runs.csv`"
    return [
        row,
        f"Time: {duration(wall)} in the stages of all {len(study.runs)} runs, {duration(cpu)} of"
        " CPU time (scene and depth count once per run, also where they were shared)",
    ]


def _scenes(study: Study) -> list[str]:
    found = {run.scene: run.record.scene for run in study.runs}
    return [
        f"{label}: protocol {outside(scene.protocol)}, fingerprint {code(scene.fingerprint)};"
        f" trained on {_some(scene.training)}; tested on {_some(scene.test) or 'none'}"
        for label, scene in found.items()
        if scene is not None and scene.training
    ]


def _some(names: Sequence[str]) -> str:
    """The names, the first `SHOWN_VIEWS` of many."""
    shown = ", ".join(outside(name) for name in names[:SHOWN_VIEWS])
    more = len(names) - SHOWN_VIEWS
    return f"{shown} and {more} more" if more > 0 else shown


def _commands(study: Study) -> list[str]:
    """The overrides, runs that differ in the seed alone together."""
    seeds: dict[str, list[str]] = defaultdict(list)
    runs = [(run.record.overrides, run.seed) for run in study.runs]
    runs += [(run.overrides, run.seed) for run in study.failed if run.seed is not None]
    for overrides, seed in runs:
        words = [word for word in overrides if not word.startswith("seed=")]
        seeds[" ".join(words)].append(str(seed))
    return [
        f"{code(line) or 'none'}: seed {', '.join(sorted(set(found), key=int))}"
        for line, found in seeds.items()
    ]


def _git(state: Mapping[str, object] | None) -> str:
    if state is None:
        return "no git checkout"
    return f"git {code(str(state['sha']))}{' with local changes' if state['dirty'] else ''}"


def _gpu(told: Mapping[str, Any]) -> str:
    return outside(f"{told['gpu']}, CUDA {told.get('cuda')}, gsplat {told.get('gsplat')}")


def _plugins(hashes: Mapping[str, str]) -> str:
    return outside(", ".join(f"{name} {digest[:12]}" for name, digest in sorted(hashes.items())))


def _packages(versions: Mapping[str, str | None]) -> str:
    found = sorted(versions.items())
    return outside(" ".join(f"{name} {number}" for name, number in found if number))
