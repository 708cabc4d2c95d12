"""The runs of a study and the study itself, as every page and figure of a report sees them."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from framework.metrics.values import Missing
from framework.records.record import POSE_CHECK, Run, RunRecord
from framework.records.search import Searched
from framework.report.study.axes import Axis
from framework.report.study.files import file_names
from framework.report.study.labels import MethodLabel, SceneLabel, listed, outside
from framework.report.study.order import BASELINE, method_order, natural
from framework.scenes import published_split

MOST_LISTED = 8  # scenes that are named one by one in a sentence
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
    def protocol(self) -> str:
        """The rule by which views train and test; "" of a run without a scene."""
        return self.record.scene.protocol if self.record.scene else ""

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

    @property
    def machine(self) -> str:
        """What kind it ran on, `AMD EPYC, 2 cores`."""
        known = self.record.provenance
        return outside(f"{known.get('cpu', 'not told')}, {known.get('cores', '?')} cores")

    @property
    def disturbed(self) -> bool:
        """Whether other programs used the cores of the training too: alone it takes no more wall
        time than CPU time."""
        wall, cpu = self.record.train_s or 0.0, self.record.train_cpu_s or 0.0
        return wall > BUSY * cpu > 0

    @property
    def poses_doubtful(self) -> bool:
        """Whether the check by stereo found that the poses do not fit the photos."""
        check = self.record.provenance.get(POSE_CHECK)
        return isinstance(check, Mapping) and check.get("fits") is False

    def level(self, axis: Axis) -> float | None:
        """The strength of a stress; None where the run's options do not have it as a number."""
        value = self.scene_label.data.get(axis.key)
        return float(value) if isinstance(value, int | float) else None


@dataclass(frozen=True)
class FailedRun:
    """A run that ended with an error. kind: of it, a word or two; again: the command that does it
    alone; "" where they were not kept. method_label, scene: empty where it left no
    configuration."""

    run_dir: Path
    error: str
    kind: str
    overrides: tuple[str, ...]
    config: Mapping[str, Any]
    provenance: Mapping[str, Any]
    again: str = ""
    method_label: MethodLabel | None = None
    scene: str = ""

    @property
    def method(self) -> str:
        return self.method_label.full if self.method_label else ""

    @property
    def seed(self) -> int | None:
        return int(self.config["seed"]) if "seed" in self.config else None


@dataclass(frozen=True)
class Study:
    """out_dir: where the report goes. runs: complete, sorted by scene, method, seed. notes: what a
    reader must be told. missing: (scene, method, seed) that a full cross would have. linked:
    whether the folders of the runs can be reached from the report. archived: folders whose
    runs are in an archive alone. searched: the trials, where the runs are those of a search. rival:
    the method, with its budget or without, to compare the others with, where somebody named one."""

    out_dir: Path
    runs: tuple[ReportRun, ...]
    failed: tuple[FailedRun, ...]
    notes: tuple[str, ...]
    missing: tuple[tuple[str, str, int], ...] = ()
    linked: bool = True
    archived: tuple[Path, ...] = ()
    searched: Searched | None = None
    rival: str = ""

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
        return sorted({run.method for run in self.runs}, key=self._order)

    @property
    def has_views(self) -> bool:
        """Whether metrics of single views are there; old archives lack them."""
        return any(run.files for run in self.runs)

    @property
    def tried(self) -> list[str]:
        """`methods` and those of which every run failed."""
        names = {run.method for run in self.runs} | {run.method for run in self.failed}
        return sorted(names - {""}, key=self._order)

    @cached_property
    def families(self) -> list[str]:
        """Method labels without budgets, in the order of `methods`."""
        rival = self.family_of.get(self.rival, self.rival)
        return sorted({*self.family_of.values()}, key=lambda f: (f != rival, method_order(f)))

    @cached_property
    def family_of(self) -> dict[str, str]:
        """Method label -> that without its budget."""
        return {run.method: run.method_label.family for run in self.runs}

    def _order(self, method: str) -> tuple[bool, bool, Any]:
        """Sort key of methods: the rival, its other budgets, then as in every report."""
        rival = self.family_of.get(self.rival, self.rival)
        other = not self.rival or self.family_of.get(method) != rival
        return method != self.rival, other, method_order(method)

    @property
    def baseline(self) -> str:
        """What the others are compared with: the `rival`, else `none + none` if it ran, else the
        first by name."""
        return self.methods[0]

    @cached_property
    def by_cpu(self) -> bool:
        """Whether to compare the CPU seconds of trainings: other programs ran beside some."""
        return any(run.disturbed for run in self.runs)

    @cached_property
    def has_budgets(self) -> bool:
        """Whether methods ran with several budgets, of which time decides."""
        return any(run.method_label.budget for run in self.runs)

    @property
    def has_plain(self) -> bool:
        """Whether the baseline is `none + none`, perhaps with options of its own."""
        return bool(self.runs) and self.baseline.startswith(BASELINE)

    @cached_property
    def without_rival(self) -> Study:
        """The same, with plain training to compare with."""
        return replace(self, rival="") if self.rival else self

    @cached_property
    def _labels(self) -> dict[str, MethodLabel]:
        """Method -> its parts."""
        return {run.method: run.method_label for run in self.runs}

    def baseline_of(self, method: str) -> str:
        """The baseline with the budget and, for another method, the other options of `method`, as
        far as there is one; plain training where the `rival` has no run of that budget; `method`
        itself where neither has."""
        if len(self.families) < 2 or method not in self._labels:
            return self.baseline
        own, plain = self._labels[method], self._labels[self.baseline].pair
        equal = [m for m in self.methods if self._labels[m].budget == own.budget]
        if all(self._labels[m].pair != plain for m in equal):
            plain = BASELINE
        bases = [m for m in equal if self._labels[m].pair == plain]
        alike = [m for m in bases if self._labels[m].options == own.options]
        if own.pair != plain and alike:
            return alike[0]
        return bases[0] if bases else method

    @cached_property
    def baselines(self) -> list[str]:
        """What methods are compared with, each once."""
        plain = {BASELINE, self._labels[self.baseline].pair} if self.runs else set()
        bases = dict.fromkeys(map(self.baseline_of, self.methods))
        return [base for base in bases if self._labels[base].pair in plain]

    @cached_property
    def without_baseline(self) -> list[str]:
        """The methods that are compared with nothing, as no baseline has their budget."""
        return [m for m in self.methods if self.baseline_of(m) not in self.baselines]

    def of(self, scene: str | None = None, method: str | None = None) -> list[ReportRun]:
        """The runs of a scene and method (None = any), by seed."""
        return [
            run for run in self.runs if scene in (None, run.scene) and method in (None, run.method)
        ]

    @cached_property
    def _files(self) -> dict[str, str]:
        """Scene -> its part in the names of files."""
        return file_names(self.scenes)

    def file_of(self, kind: str, scene: str) -> str:
        """The name, without its ending, of a figure of this kind of a scene; no other has it."""
        return f"{kind}_{self._files[scene]}"

    def name_of(self, scene: str) -> str:
        """The name in its record of a scene with this label."""
        return next(run.scene_label.name for run in self.runs if run.scene == scene)

    def counted(self, scenes: Sequence[str]) -> str:
        """How many these are: `5 scenes`; with conditions of one scene among them, `6 conditions of
        5 scenes` or `3 conditions of fern`."""
        names = list(dict.fromkeys(map(self.name_of, scenes)))
        if len(names) == len(scenes):
            return f"{len(scenes)} scenes"
        of = names[0] if len(names) == 1 else f"{len(names)} scenes"
        return f"{len(scenes)} conditions of {of}"

    def listed(self, scenes: Sequence[str]) -> str:
        """`a, b and c`; of many, conditions of one scene are taken together: `fern (4
        conditions)`."""
        if len(scenes) <= MOST_LISTED:
            return listed(scenes, "and")
        times = Counter(map(self.name_of, scenes))
        return listed([f"{n} ({k} conditions)" if k > 1 else n for n, k in times.items()], "and")

    def split_as_published(self, scene: str) -> bool:
        """Whether the photos of a scene are shared out by a rule that papers use."""
        known = {run.protocol for run in self.of(scene)} - {""}
        return all(published_split(name) for name in known)

    def folder_of(self, run_dir: Path) -> str:
        """`run_dir` as seen from the report."""
        return Path(os.path.relpath(run_dir.resolve(), self.out_dir.resolve())).as_posix()
