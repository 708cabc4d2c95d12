"""The runs of a study, each with the name of its method and of its scene.

A method is what a user compares: augmenter and regularizer, plus every other option that differs
between the runs: another capacity plugin, depth provider or initializer, an option of a plugin
that differs between runs of the same plugin, `trainer.steps`, and so on. The seed, the scene and
keys that cannot change a result (`NEUTRAL_KEYS`) are no part of it.
"""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from framework.errors import require
from framework.metrics import Missing
from framework.provenance import NEUTRAL_KEYS
from framework.record import METHOD_GROUPS, RECORD, Run, RunRecord, read_run

NAMED = ("augment", "reg")  # groups every method's name starts with
NO_METHOD = ("seed", "scene", "metrics", *NEUTRAL_KEYS)
BASELINE = "none + none"


@dataclass(frozen=True)
class ReportRun:
    """A complete run with the labels it has in this study."""

    run: Run
    method: str
    scene: str

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


@dataclass(frozen=True)
class Study:
    """runs: complete, sorted by scene, method, seed. notes: what a reader must be told."""

    study_dir: Path
    runs: tuple[ReportRun, ...]
    failed: tuple[Run, ...]
    notes: tuple[str, ...]

    @property
    def scenes(self) -> list[str]:
        """Scene labels, sorted."""
        return sorted({run.scene for run in self.runs})

    @property
    def methods(self) -> list[str]:
        """Method labels: the baseline first, then by name."""
        return sorted({run.method for run in self.runs}, key=method_order)

    @property
    def baseline(self) -> str:
        """What the others are compared with: `none + none` if it ran, else the first by name."""
        return self.methods[0]

    def of(self, scene: str | None = None, method: str | None = None) -> list[ReportRun]:
        """The runs of a scene and method (None = any), by seed."""
        return [
            run for run in self.runs if scene in (None, run.scene) and method in (None, run.method)
        ]


def method_order(method: str) -> tuple[bool, bool, str]:
    """Sort key: plain `none + none`, then its variants, then the others by name."""
    return method != BASELINE, not method.startswith(BASELINE), method


def collect(study_dir: Path) -> Study:
    """Read every record below `study_dir`. Raises UserError if there is none or one is damaged."""
    paths = sorted(study_dir.rglob(RECORD)) if study_dir.is_dir() else []
    require(
        len(paths) > 0,
        f"{study_dir}: expected a study's folder with runs in it, got none; give the folder that"
        " holds runs/, as reports/embedded",
    )
    runs = [read_run(path.parent) for path in paths]
    complete = [run for run in runs if run.record.status == "complete"]
    configs = [run.record.config for run in complete]
    methods, scenes = method_labels(configs), scene_labels([run.record for run in complete])
    labelled = [ReportRun(*parts) for parts in zip(complete, methods, scenes, strict=True)]
    unique, repeated = _without_repeats(labelled)
    unique.sort(key=lambda r: (r.scene, method_order(r.method), r.seed))
    failed = tuple(run for run in runs if run.record.status != "complete")
    return Study(study_dir, tuple(unique), failed, (*repeated, *_code_notes(complete)))


def method_labels(configs: Sequence[Mapping[str, Any]]) -> list[str]:
    """The name of each run's method among `configs`; equal configs have equal names."""
    flat = [_flatten(config) for config in configs]
    varying = sorted({key for key in set().union(*flat) if _varies(key, flat)})
    return [_method_label(entry, varying) for entry in flat]


def scene_labels(records: list[RunRecord]) -> list[str]:
    """The scene's name; where one name stands for several scenes, with what tells them apart."""
    variants: dict[str, set[str]] = defaultdict(set)
    for record in records:
        if record.scene is not None:
            variants[record.scene.name].add(record.scene.fingerprint)
    return [_scene_label(record, records, variants) for record in records]


def _scene_label(
    record: RunRecord, records: list[RunRecord], variants: Mapping[str, set[str]]
) -> str:
    scene = record.scene
    if scene is None:
        return "unknown scene"
    if len(variants[scene.name]) == 1:
        return scene.name
    alike = [_flatten(r.config) for r in records if r.scene and r.scene.name == scene.name]
    own = _flatten(record.config)
    options = sorted({k for e in alike for k in e if k.startswith("scene.") and _varies(k, alike)})
    named = [f"{key.removeprefix('scene.')}={_text(own.get(key))}" for key in options]
    # the fingerprint settles what the options do not tell, such as edited images
    return f"{scene.name} ({', '.join([*named, scene.fingerprint[:8]])})"


def _flatten(config: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Dotted keys of a nested config."""
    flat: dict[str, Any] = {}
    for key, value in config.items():
        if isinstance(value, Mapping):
            flat |= _flatten(value, f"{prefix}{key}.")
        else:
            flat[f"{prefix}{key}"] = value
    return flat


def _varies(key: str, configs: list[dict[str, Any]]) -> bool:
    """Whether runs differ in `key`; an option of a plugin only counts among runs of that plugin."""
    group = key.split(".")[0]
    seen: dict[Any, set[str]] = defaultdict(set)
    for config in configs:
        own = group in METHOD_GROUPS and key != f"{group}.name"
        name = config.get(f"{group}.name") if own else None
        if not own or key in config:
            seen[name].add(_text(config.get(key)))
    return any(len(values) > 1 for values in seen.values())


def _method_label(config: dict[str, Any], varying: Iterable[str]) -> str:
    named = " + ".join(str(config.get(f"{group}.name", "none")) for group in NAMED)
    parts = [named]
    for key in varying:
        group, _, option = key.partition(".")
        if group in NO_METHOD or key in {f"{g}.name" for g in NAMED} or key not in config:
            continue
        parts.append(f"{group if option == 'name' else key}={_text(config[key])}")
    return ", ".join(parts)


def _text(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value)


def _without_repeats(runs: list[ReportRun]) -> tuple[list[ReportRun], list[str]]:
    """One run per scene, method and seed: the first by folder; the others are told."""
    kept: dict[tuple[str, str, int], ReportRun] = {}
    notes = []
    for run in runs:
        first = kept.setdefault((run.scene, run.method, run.seed), run)
        if first is not run:
            notes.append(
                f"{run.method} on {run.scene} with seed {run.seed} was found twice; the run in"
                f" `{run.run.run_dir.name}` is left out in favour of `{first.run.run_dir.name}`."
            )
    return list(kept.values()), notes


def _code_notes(runs: list[Run]) -> list[str]:
    versions = {str(run.record.provenance.get("code")) for run in runs}
    if len(versions) < 2:
        return []
    return [
        f"The runs were made with {len(versions)} versions of the code, which may explain a"
        " difference; the study's command repeats the outdated ones."
    ]
