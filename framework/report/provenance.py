"""Where a report's numbers come from: code, packages, machine, scenes, commands, time, papers."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from framework.compute.stopwatch import duration
from framework.records.provenance import BITS
from framework.report.study.study import Study
from framework.report.study.words import code, outside

SHOWN_VIEWS = 12


@dataclass(frozen=True)
class Provenance:
    """Lines of the section.

    Attributes:
        varying_bits: whether some run's rasterizer is not deterministic.
    """

    facts: list[str]
    scenes: list[str]
    commands: list[str]
    varying_bits: bool


def provenance(study: Study) -> Provenance:
    """The provenance of all runs, complete and failed."""
    sources = [run.record.provenance for run in study.runs]
    sources += [run.record.provenance for run in study.failed if run.record.provenance]
    facts = {name: sorted(set(v) - {"", "None"}) for name, v in _facts(sources).items()}
    lines = [f"{name}: {'; '.join(values)}" for name, values in facts.items() if values]
    varying = any(BITS in source for source in sources)
    return Provenance([*lines, *_times(study)], _scenes(study), _commands(study), varying)


def _facts(sources: Sequence[Mapping[str, Any]]) -> dict[str, list[str]]:
    """Each fact with its value in every run."""

    def texts(key: str) -> list[str]:
        return [outside(str(source.get(key))) for source in sources]

    return {
        "Code": [
            f"{_git(p) or 'no git checkout'}, sources {code(str(p.get('code'))[:12])}"
            for p in sources
        ],
        "Plugins": [_pairs(p.get("plugins") or {}, 12) for p in sources],
        "fishersplat": texts("fishersplat"),
        "Python": texts("python"),
        "Packages": [_pairs(p.get("packages") or {}, 40) for p in sources],
        "CPU": [outside(f"{p['cpu']}, {p.get('cores')} cores") for p in sources if "cpu" in p],
        "Threads": texts("threads"),
        "System": texts("system"),
        "GPU": [
            outside(f"{p['gpu']}, CUDA {p.get('cuda')}, gsplat {p.get('gsplat')}")
            for p in sources
            if p.get("gpu")
        ],
        "Bits": texts(BITS),
    }


def _git(source: Mapping[str, Any], length: int | None = None) -> str:
    """`git 80cf492d6c with local changes`; "" without a checkout."""
    state = source.get("git")
    if not state:
        return ""
    sha = code(str(state["sha"])) if length is None else outside(str(state["sha"])[:length])
    return f"git {sha}{' with local changes' if state['dirty'] else ''}"


def _pairs(values: Mapping[str, str | None], length: int) -> str:
    """`name value, name value`, values cut to a length."""
    return outside(", ".join(f"{name} {v[:length]}" for name, v in sorted(values.items()) if v))


def code_of(source: Mapping[str, Any]) -> str:
    """The code of a run, for a table."""
    return _git(source, 10) or f"sources {outside(str(source.get('code'))[:12])}"


def _times(study: Study) -> list[str]:
    if not study.runs:
        return []
    stages = [stage for run in study.runs for stage in run.record.timings.values()]
    wall, cpu = sum(stage.wall_s for stage in stages), sum(stage.cpu_s for stage in stages)
    return [
        "One row per run, with options and results: `runs.csv`",
        f"Time: {duration(wall)} in the stages of all {len(study.runs)} runs, {duration(cpu)} of"
        " CPU time (scene and depth count for every run, even if shared)",
    ]


def _scenes(study: Study) -> list[str]:
    records = {run.scene: run.record.scene for run in study.runs}
    return [
        f"{label}: protocol {outside(scene.protocol)}, fingerprint {code(scene.fingerprint)};"
        f" trained on {_first(scene.training)}; tested on {_first(scene.test) or 'none'}"
        for label, scene in records.items()
        if scene is not None and scene.training
    ]


def _first(names: Sequence[str]) -> str:
    """The names, the first `SHOWN_VIEWS` of many."""
    shown = ", ".join(outside(name) for name in names[:SHOWN_VIEWS])
    more = len(names) - SHOWN_VIEWS
    return f"{shown} and {more} more" if more > 0 else shown


def _commands(study: Study) -> list[str]:
    """The overrides, runs that differ in the seed alone together."""
    seeds: dict[str, list[str]] = defaultdict(list)
    runs = [(run.record.overrides, run.seed) for run in study.runs]
    runs += [(run.record.overrides, run.seed) for run in study.failed if run.seed is not None]
    for overrides, seed in runs:
        words = [word for word in overrides if not word.startswith("seed=")]
        seeds[" ".join(words)].append(str(seed))
    return [
        f"{code(line) or 'none'}: seed {', '.join(sorted(set(values), key=int))}"
        for line, values in seeds.items()
    ]
