"""The runs of a study, and the study itself."""

from __future__ import annotations

import hashlib
import os
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from framework.metrics.values import METRICS, Missing
from framework.records.archive import Entry
from framework.records.record import LPIPS, POSE_CHECK, Run, RunRecord
from framework.records.search import Searched
from framework.report.study.axes import Axis
from framework.report.study.methods import PLAIN, Method
from framework.report.study.plugins import summary, title
from framework.report.study.scenes import SceneLabel
from framework.report.study.words import listed, natural, outside
from framework.scenes import HELD_OUT, published_split

MOST_LISTED = 8  # scenes that a sentence lists one by one
DAMAGED = "damaged"  # the kind of failure of a folder that no run wrote
BUSY = 1.3  # wall seconds per CPU second of a training that shared its cores
NAME_LENGTH = 120  # characters of a scene in the name of a file


@dataclass(frozen=True)
class ReportRun:
    """A complete run with its method and scene in this study."""

    run: Run
    method: Method
    scene_label: SceneLabel

    @cached_property
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
        """The rule that divides training and test views; "" of a run without a scene."""
        return self.record.scene.protocol if self.record.scene else ""

    @property
    def held_out(self) -> bool:
        """Whether it was evaluated on training views that were held out."""
        return self.protocol.endswith(HELD_OUT)

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
        """The kind of machine, as `AMD EPYC, 2 cores`."""
        source = self.record.provenance
        return outside(f"{source.get('cpu', 'unknown CPU')}, {source.get('cores', '?')} cores")

    @property
    def disturbed(self) -> bool:
        """Whether other programs used the cores during the training."""
        wall, cpu = self.record.train_s or 0.0, self.record.train_cpu_s or 0.0
        return wall > BUSY * cpu > 0

    @property
    def poses_doubtful(self) -> bool:
        """Whether the check by stereo found that the poses do not fit the photos."""
        check = self.record.provenance.get(POSE_CHECK)
        return isinstance(check, Mapping) and check.get("fits") is False

    def level(self, axis: Axis) -> float | None:
        """The strength of a stress; None if the run's options do not have it as a number."""
        value = self.scene_label.data.get(axis.key)
        return float(value) if isinstance(value, int | float) else None


@dataclass(frozen=True)
class FailedRun(Entry):
    """A run that ended with an error.

    Attributes:
        method, scene: None and "" if the run left no configuration.
    """

    method: Method | None = None
    scene: str = ""

    @property
    def record(self) -> RunRecord:
        return self.run.record

    @property
    def seed(self) -> int | None:
        return int(self.record.config["seed"]) if "seed" in self.record.config else None


@dataclass(frozen=True)
class Study:
    """All runs of a report.

    Attributes:
        out_dir: folder of the report.
        runs: complete runs, sorted by scene, method and seed.
        notes: on the names of methods and on repeated runs that are left out.
        missing: (scene, method, seed) that a full cross of the study would have.
        linked: the report may link to the folders of the runs.
        archived: folders whose runs exist only in an archive.
        searched: the trials of a search.
        rival: the chosen baseline, with or without its budget.
        sources: provenance of all complete runs.
        begun: folders of runs without a result.
    """

    out_dir: Path
    runs: tuple[ReportRun, ...]
    failed: tuple[FailedRun, ...] = ()
    notes: tuple[str, ...] = ()
    missing: tuple[tuple[str, Method, int], ...] = ()
    linked: bool = True
    archived: tuple[Path, ...] = ()
    searched: Searched | None = None
    rival: Method | None = None
    sources: tuple[Mapping[str, Any], ...] = ()
    begun: tuple[str, ...] = ()

    @cached_property
    def scenes(self) -> list[str]:
        """Scene labels, sorted."""
        return sorted({run.scene for run in self.runs}, key=natural)

    @cached_property
    def tested(self) -> list[str]:
        """The scenes, sorted, on which some run had test views."""
        return sorted({run.scene for run in self.runs if run.tested}, key=natural)

    @cached_property
    def methods(self) -> list[Method]:
        """The rival or the baseline first, then by name."""
        return sorted({run.method for run in self.runs}, key=self._order)

    @cached_property
    def plugins(self) -> list[tuple[str, str]]:
        """Display name and summary of the augmenters and regularizers of the study."""
        chosen = dict.fromkeys(choice for m in self.methods for choice in m.plugins.items())
        lines = [(title(group, name), summary(group, name)) for group, name in chosen]
        return [(name, line) for name, line in lines if line]

    @property
    def tried(self) -> list[Method]:
        """`methods` and those whose runs all failed."""
        failed = {run.method for run in self.failed if run.method}
        return sorted({*self.methods, *failed}, key=self._order)

    @cached_property
    def families(self) -> list[Method]:
        """The methods without budgets: that of the rival or the baseline first, then by name."""
        rival = self.rival.family if self.rival else None
        return sorted({m.family for m in self.methods}, key=lambda f: (f != rival, f.order))

    def _order(self, method: Method) -> tuple[bool, bool, Any]:
        """Sort key: the rival, its other budgets, then as in every report."""
        other = self.rival is not None and method.family != self.rival.family
        return self.rival is not None and method != self.rival, other, method.order

    @property
    def has_views(self) -> bool:
        """Whether metrics of single views exist; older archives lack them."""
        return any(run.files for run in self.runs)

    @property
    def baseline(self) -> Method:
        """The method that others are compared with: `rival`, else training without a method, else
        the first by name."""
        return self.methods[0]

    @cached_property
    def by_cpu(self) -> bool:
        """Whether to compare CPU seconds of trainings, as other programs ran during some."""
        return any(run.disturbed for run in self.runs)

    @cached_property
    def has_budgets(self) -> bool:
        """Whether methods ran with several budgets."""
        return any(run.method.budget for run in self.runs)

    @property
    def has_plain(self) -> bool:
        """Whether the baseline is plain training, perhaps with other options."""
        return bool(self.runs) and self.baseline.pair == PLAIN

    @cached_property
    def without_rival(self) -> Study:
        return replace(self, rival=None) if self.rival else self

    def baseline_of(self, method: Method) -> Method:
        """Return what `method` is compared with.

        It is the baseline with the same budget and, if there is one, the same other options.
        Without a run of the `rival` with that budget it is plain training, and without that
        `method` itself.
        """
        return self._baselines.get(method, self.baseline)

    @cached_property
    def _baselines(self) -> dict[Method, Method]:
        if len(self.families) < 2:
            return {}
        return {method: self._baseline_of(method) for method in self.methods}

    def _baseline_of(self, method: Method) -> Method:
        pair = self.baseline.pair
        equal = [other for other in self.methods if other.budget == method.budget]
        if all(other.pair != pair for other in equal):
            pair = PLAIN
        bases = [other for other in equal if other.pair == pair]
        alike = [other for other in bases if other.options == method.options]
        if method.pair != pair and alike:
            return alike[0]
        return bases[0] if bases else method

    @cached_property
    def baselines(self) -> list[Method]:
        """The baselines of all methods, without repeats."""
        pairs = {PLAIN, self.baseline.pair} if self.runs else set()
        bases = dict.fromkeys(map(self.baseline_of, self.methods))
        return [base for base in bases if base.pair in pairs]

    @cached_property
    def without_baseline(self) -> list[Method]:
        """The methods that are compared with nothing, as no baseline has their budget."""
        return [m for m in self.methods if self.baseline_of(m) not in self.baselines]

    def of(self, scene: str | None = None, method: Method | None = None) -> list[ReportRun]:
        """The runs of a scene and method (None = any), by seed."""
        runs = self.runs if method is None else self._by_method.get(method, [])
        return [run for run in runs if scene in (None, run.scene)]

    @cached_property
    def _by_method(self) -> dict[Method, list[ReportRun]]:
        groups: dict[Method, list[ReportRun]] = {}
        for run in self.runs:
            groups.setdefault(run.method, []).append(run)
        return groups

    def file_of(self, kind: str, scene: str) -> str:
        """The name, without its ending, of a figure of this kind; no other scene has it."""
        return f"{kind}_{self._files[scene]}"

    @cached_property
    def _files(self) -> dict[str, str]:
        return file_names(self.scenes)

    def name_of(self, scene: str) -> str:
        """The name in its record of a scene with this label."""
        return next(run.scene_label.name for run in self.runs if run.scene == scene)

    def counted(self, scenes: Sequence[str]) -> str:
        """Format a count: `5 scenes`, `6 conditions of 5 scenes` or `3 conditions of fern`."""
        names = list(dict.fromkeys(map(self.name_of, scenes)))
        if len(names) == len(scenes):
            return f"{len(scenes)} scenes"
        of = names[0] if len(names) == 1 else f"{len(names)} scenes"
        return f"{len(scenes)} conditions of {of}"

    def listed(self, scenes: Sequence[str]) -> str:
        """`a, b and c`; many conditions of one scene together: `fern (4 conditions)`."""
        if len(scenes) <= MOST_LISTED:
            return listed(scenes)
        times = Counter(map(self.name_of, scenes))
        return listed([f"{n} ({k} conditions)" if k > 1 else n for n, k in times.items()])

    def split_as_published(self, scene: str) -> bool:
        """Whether a rule of the literature divides the photos of a scene."""
        protocols = {run.protocol for run in self.of(scene)} - {""}
        return all(published_split(name) for name in protocols)

    def folder_of(self, run_dir: Path) -> str:
        """`run_dir` relative to the report."""
        return Path(os.path.relpath(run_dir.resolve(), self.out_dir.resolve())).as_posix()

    @cached_property
    def other_metrics(self) -> list[str]:
        """Metrics of plugins in some run, sorted."""
        return sorted({name for run in self.runs for name in run.record.summary} - {*METRICS})

    @cached_property
    def lpips_networks(self) -> list[str]:
        """The networks that LPIPS was measured with, sorted; older runs do not name theirs."""
        sources = [r.record.provenance for r in self.runs if r.mean("lpips") is not None]
        return sorted({outside(str(p[LPIPS])) for p in sources if p.get(LPIPS)})


def file_names(texts: Iterable[str]) -> dict[str, str]:
    """A part of a file name for each text, distinct also on disks that ignore letters' case."""
    slugs = {text: slug(text) for text in texts}
    times = Counter(name.lower() for name in slugs.values())
    return {
        text: name if times[name.lower()] == 1 else _with_hash(name, text)
        for text, name in slugs.items()
    }


def slug(text: str) -> str:
    """`text` as part of a file name; with a hash of it if letters are lost."""
    name = re.sub(r"[^A-Za-z0-9]+", "_", text).strip("_")
    if name and text.isascii() and len(name) <= NAME_LENGTH:
        return name
    return _with_hash(name[:NAME_LENGTH], text)


def _with_hash(name: str, text: str) -> str:
    digest = hashlib.sha256(text.encode("utf-8", "replace")).hexdigest()[:8]
    return "_".join(filter(None, (name, digest)))
