"""A finished run on disk. Every file is written whole or not at all; `record.json` comes last, so
a folder with a complete record is complete.

    record.json        status, identity, config, scene, timings, summary, provenance
    failed.json        only if the last attempt failed: its error and overrides; if the training
                       diverged, diverged.safetensors holds the state
    metrics.csv        one row per test view; an empty cell is explained in its column `missing`
    history.csv        one row per logged step: loss, PSNR, Gaussians, seconds of training
    point_cloud.ply    the trained Gaussians, see `framework.records.ply`
    cameras.json       its cameras, for viewers; so is transforms.json (`framework.records.cameras`)
    settings.json      a first view and the background (`framework.records.first_view`)
    photos/            <view>.jpg of the training views (`framework.records.run_files`)
    renders/           <view>.png, <view>_truth.png, <view>_error.png (and <view>_mask.png)

The error map is the absolute difference of the two 8-bit images, mean over channels, in the colour
map `magma` (perceptually uniform) from 0 (black) to `ERROR_SCALE` (pale yellow), clipped there: one
fixed scale for every run, so that maps compare across methods.

Times are seconds: wall clock, and CPU time of the process. JSON is strict: what has no finite value
is null with its reason in another field. Importing this module and reading records needs no torch.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from framework.errors import UserError, printable_line, require
from framework.files.documents import read_json
from framework.files.limits import RUN_BYTES
from framework.files.opened import is_file, reading
from framework.files.paths import inside
from framework.files.whole import Written, difference, following, write_whole
from framework.metrics.evaluate import mean_of
from framework.metrics.values import METRICS, Measurement, Missing, ViewMetrics
from framework.records.provenance import NEUTRAL_KEYS, plain_json, provenance, strict_json
from framework.records.record_check import check_failure, check_record
from framework.records.run_files import (
    EMPTY,
    HISTORY_CSV,
    METRICS_CSV,
    RENDERS,
    HistoryRow,
    Table,
    file_stems,
    history_csv,
    metrics_csv,
    read_table,
    write_renders,
)

if TYPE_CHECKING:
    from torch import Tensor

    from framework.types import Gaussians, View

TRAIN_STAGE = "train"  # the stage whose wall time the report calls train seconds
EXPOSURE = "exposure_rms"  # in the provenance: of the photos' log gains, where they were evened
POSE_CHECK = "pose_check"  # in the provenance: shares and ratio, None where it was not made
LPIPS = "lpips"  # in the provenance: the network that LPIPS was measured with, None for none
LEARNED = "learned_weights"  # in the provenance: of poses and depth, "" if no network was used
METHOD_GROUPS = ("augment", "reg", "capacity", "depth", "init")
RECORD, FAILED, PLY = "record.json", "failed.json", "point_cloud.ply"
DIVERGED = "diverged.safetensors"
AGAIN = "delete that folder and run again"
FEW = 3  # options that a message names


@dataclass(frozen=True)
class StageTime:
    """Seconds of one stage: wall clock, and CPU time of the whole process."""

    wall_s: float
    cpu_s: float


@dataclass(frozen=True)
class SceneInfo:
    """The scene of a run.

    Attributes:
        fingerprint: SHA-256 of all that was loaded.
        training, test: names of views, the latter empty where every one trains.
    """

    name: str
    protocol: str
    fingerprint: str
    training: tuple[str, ...]
    test: tuple[str, ...]


@dataclass(frozen=True)
class RunRecord:
    """One run. `write_run` fills in the fields from `gaussians` down.

    Attributes:
        config: resolved.
        timings: by stage, in order; the training itself is `TRAIN_STAGE`.
        provenance: see `framework.records.provenance`.
        resumed: how often an interrupted training was taken up again; its time is the sum of the
            parts, the other stages' that of the last process.
        sh_degree: the highest of any Gaussian.
        banded: how many have one above 0; None: all, or none where it is 0.
        summary: mean over the test views of each metric.
        dose: what the method did, by the trainer's own counts, as a flat mapping to numbers and
            texts; empty where none were kept.
        warnings: everything that the run warned about, one line each.
        files: path within the folder -> bytes and SHA-256 of every other file that the run wrote.
        error: one line, of a failed run.
    """

    identity: str
    config: Mapping[str, Any]
    overrides: tuple[str, ...]
    scene: SceneInfo | None
    timings: Mapping[str, StageTime]
    provenance: Mapping[str, Any]
    peak_memory_bytes: int = 0
    resumed: int = 0
    gaussians: int = 0
    sh_degree: int = 0
    banded: int | None = None
    parameters_sha256: str = ""
    ply_bytes: int = 0
    summary: Mapping[str, Measurement] = field(default_factory=dict)
    dose: Mapping[str, Any] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    files: Mapping[str, tuple[int, str]] = field(default_factory=dict)
    status: str = "complete"
    error: str | None = None

    @classmethod
    def failed(
        cls,
        error: str,
        config: Mapping[str, Any],
        overrides: Sequence[str],
        provenance: Mapping[str, Any],
    ) -> RunRecord:
        """The record of a run that ended with an error."""
        words = tuple(overrides)
        return cls("", config, words, None, {}, provenance, status="failed", error=error)

    @property
    def seed(self) -> int:
        """The config's seed."""
        return int(self.config["seed"])

    @property
    def methods(self) -> dict[str, str]:
        """The chosen plugin, depth provider and initializer by group."""
        groups = {group: self.config.get(group) for group in METHOD_GROUPS}
        return {g: str(c["name"]) for g, c in groups.items() if isinstance(c, Mapping)}

    @property
    def parameters(self) -> int:
        """Stored numbers: of each Gaussian 14, and 3 for every SH coefficient above the first of
        those that have any."""
        banded = self.gaussians if self.banded is None else self.banded
        return 14 * self.gaussians + 3 * ((self.sh_degree + 1) ** 2 - 1) * banded

    @property
    def train_s(self) -> float | None:
        """Wall seconds of the training stage."""
        stage = self.timings.get(TRAIN_STAGE)
        return None if stage is None else stage.wall_s

    @property
    def train_cpu_s(self) -> float | None:
        """CPU seconds of the training stage, of all threads."""
        stage = self.timings.get(TRAIN_STAGE)
        return None if stage is None else stage.cpu_s


@dataclass(frozen=True)
class Run:
    """A run read back.

    Attributes:
        metrics, history: the two tables, empty for a failed run.
    """

    run_dir: Path
    record: RunRecord
    metrics: Table = EMPTY
    history: Table = EMPTY


def write_run(
    run_dir: Path,
    record: RunRecord,
    metrics: Sequence[ViewMetrics],
    history: Sequence[HistoryRow],
    gaussians: Gaussians,
    background: Tensor,
    renders: Sequence[tuple[View, Tensor]],
    before: Written | None = None,
    stale: Sequence[str] = (),
) -> RunRecord:
    """Write all files of a finished run; returns the record as written.

    Args:
        background: [3].
        renders: the test views with their [3, H, W] images, in the order of `metrics`.
        before: what of the run was written already.
        stale: files of an earlier run, which are removed unless this one writes them too. An old
            record is removed first, so that a half-repeated run never looks complete.
    """
    from framework.records.ply import write_ply

    stale = (*stale, *remove_record(run_dir))

    if [m.view for m in metrics] != [view.name for view, _ in renders]:
        raise ValueError("write_run: expected metrics and renders of the same views in one order")
    stems = file_stems([m.view for m in metrics])
    with following(run_dir) as written:
        write_renders(run_dir / RENDERS, stems, renders)
        ply_bytes = write_ply(run_dir / PLY, gaussians, background)
        write_whole(run_dir / METRICS_CSV, metrics_csv(metrics, stems))
        write_whole(run_dir / HISTORY_CSV, history_csv(history))
    followed = [written] if before is None else [before, written]
    files = {name: of for part in followed for name, of in part.listed().items()}
    _remove(run_dir, set(stale) - set(files))
    finished = dataclasses.replace(
        record,
        files=files,
        gaussians=len(gaussians),
        sh_degree=gaussians.sh_degree,
        banded=len(gaussians.shN) if gaussians.sh_degree else None,
        parameters_sha256=parameters_sha256(gaussians),
        ply_bytes=ply_bytes,
        summary={
            name: mean_of(metrics, name)
            for name in (*METRICS, *(metrics[0].also if metrics else ()))
        },
        status="complete",
        error=None,
    )
    write_record(run_dir, finished)
    for name in (FAILED, DIVERGED):  # of an earlier attempt
        (run_dir / name).unlink(missing_ok=True)
    return finished


def remove_record(run_dir: Path) -> list[str]:
    """Remove the record and return the files that it lists, which a repetition replaces."""
    try:
        files = list(read_record(run_dir / RECORD).files)
    except UserError:  # none, or damaged: whose files the others are is not known
        files = []
    (run_dir / RECORD).unlink(missing_ok=True)
    return files


def _remove(run_dir: Path, names: Iterable[str]) -> None:
    for name in names:
        with contextlib.suppress(UserError, OSError):  # not inside, or a folder
            inside(run_dir, name).unlink(missing_ok=True)


def write_failed(
    run_dir: Path,
    config: Mapping[str, Any],
    overrides: Sequence[str],
    error: str,
    kind: str = "bug",
    again: str = "",
) -> RunRecord:
    """Record a run that ended with `error` (one line) of this kind, with the command that repeats
    it, for the report of the study.

    `failed.json` holds the last attempt; so does the record, unless it is of a complete run, which
    is kept.
    """
    error = printable_line(" ".join(error.split()))
    content = {"error": error, "kind": kind, "overrides": list(overrides), "again": again}
    write_whole(run_dir / FAILED, strict_json(content, indent=2) + "\n")
    record = RunRecord.failed(error, config, overrides, provenance())
    if not _is_complete(run_dir):
        write_record(run_dir, record)
    return record


def _is_complete(run_dir: Path) -> bool:
    try:
        return read_record(run_dir / RECORD).status == "complete"
    except UserError:  # no record yet, or a damaged one
        return False


def read_record(path: Path) -> RunRecord:
    """The record in a `record.json`.

    Raises:
        UserError: when it is missing or damaged.
    """
    content = read_json(path, RUN_BYTES)
    with reading(path, "a run's record", AGAIN):
        record = record_of(content)
    return record


def read_run(run_dir: Path) -> Run:
    """A run with its tables, without torch.

    Raises:
        UserError: when files are missing or damaged.
    """
    record = read_record(run_dir / RECORD)
    if record.status != "complete":
        return Run(run_dir, record)
    with reading(run_dir, f"{METRICS_CSV} and {HISTORY_CSV} as a run writes them", AGAIN):
        metrics, history = (read_table(run_dir / name) for name in (METRICS_CSV, HISTORY_CSV))
    return Run(run_dir, record, metrics, history)


def find_complete(run_dir: Path, identity: str) -> RunRecord | None:
    """The record of a complete run with this identity in `run_dir`; None if there is none."""
    if not all(is_file(run_dir / name) for name in (RECORD, METRICS_CSV, HISTORY_CSV, PLY)):
        return None
    try:
        record = read_run(run_dir).record
    except UserError:
        # damaged or of an older layout: not the asked-for result, so it is run again
        return None
    same = record.status == "complete" and record.identity == identity
    return record if same and not damaged_file(run_dir, identity) else None


def check_replaceable(run_dir: Path, config: Mapping[str, Any]) -> None:
    """Raise UserError if `run_dir` holds a complete run of another configuration, which a run of
    `config` would replace. `force` permits it.

    Options that only one of the two has do not count: they are of another version of the code.
    """
    if config["force"] or not _is_complete(run_dir):
        return
    held = _flat(read_record(run_dir / RECORD).config)
    wanted = _flat(plain_json(config))
    other = [key for key in held if key in wanted and held[key] != wanted[key]]
    other.sort(key=lambda key: not key.endswith(".name"))  # choices before their options
    few = [f"{key.removesuffix('.name')}={held[key]}" for key in other[:FEW]]
    few += ["..."] if len(other) > FEW else []
    require(
        not other,
        f"{run_dir}: expected an empty folder or the same run, got a complete run of another"
        f" configuration ({', '.join(few)}); give another folder, or force=true to replace that"
        " run",
    )


def _flat(config: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Dotted keys of all options that can change a run."""
    flat: dict[str, Any] = {}
    for key, value in config.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping):
            flat |= _flat(value, f"{name}.")
        elif name not in NEUTRAL_KEYS:
            flat[name] = value
    return flat


def damaged_file(run_dir: Path, identity: str) -> str:
    """Describe the first file of the run of this identity that is not as written; "" if all are."""
    try:
        record = read_record(run_dir / RECORD)
    except UserError:
        return f"{RECORD} is damaged" if is_file(run_dir / RECORD) else ""
    for name, (size, digest) in record.files.items() if record.identity == identity else ():
        problem = difference(inside(run_dir, name), size, digest)
        if problem:
            return f"{name}: expected the {size:,} bytes that the run wrote, got {problem}"
    return ""


def parameters_sha256(gaussians: Gaussians) -> str:
    """SHA-256 over name, type, shape and bits of every stored parameter."""
    digest = hashlib.sha256()
    for name, tensor in gaussians.items():
        array = np.ascontiguousarray(tensor.detach().cpu().numpy())
        digest.update(f"{name} {array.dtype.str} {array.shape}\0".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()


def write_record(run_dir: Path, record: RunRecord) -> None:
    """Write `record.json` alone; the other files of a complete run must be there."""
    content = record_content(record)
    try:  # what the reader refuses must not look like a finished run
        check_record(plain_json(content))
    except (ValueError, KeyError, TypeError) as error:
        raise UserError(f"{run_dir / RECORD}: cannot hold this run: {error}") from error
    write_whole(run_dir / RECORD, strict_json(content, indent=2) + "\n")


def record_content(record: RunRecord) -> dict[str, Any]:
    """A record as plain values, which `record_of` reads."""
    content = {f.name: getattr(record, f.name) for f in dataclasses.fields(record)}
    content["seed"] = record.config.get("seed")
    content["methods"] = record.methods
    content["parameters"] = record.parameters
    content["scene"] = None if record.scene is None else dataclasses.asdict(record.scene)
    content["files"] = {
        name: {"bytes": size, "sha256": digest} for name, (size, digest) in record.files.items()
    }
    content["timings"] = [{"stage": k, **dataclasses.asdict(v)} for k, v in record.timings.items()]
    content["summary"] = {
        name: {"mean": None, "missing": value.reason}
        if isinstance(value, Missing)
        else {"mean": value, "missing": None}
        for name, value in record.summary.items()
    }
    return content


def record_of(content: dict[str, Any]) -> RunRecord:
    """The record with this content.

    Raises:
        ValueError, KeyError or TypeError: for any other.
    """
    check_record(content)
    scene = content["scene"]
    lists = ("training", "test")
    fields = {f.name: content[f.name] for f in dataclasses.fields(RunRecord)}
    return RunRecord(
        **fields
        | {
            "overrides": tuple(content["overrides"]),
            "warnings": tuple(content["warnings"]),
            "scene": scene and SceneInfo(**scene | {key: tuple(scene[key]) for key in lists}),
            "files": {name: (of["bytes"], of["sha256"]) for name, of in content["files"].items()},
            "timings": {
                entry["stage"]: StageTime(entry["wall_s"], entry["cpu_s"])
                for entry in content["timings"]
            },
            "summary": {
                name: Missing(entry["missing"]) if entry["mean"] is None else entry["mean"]
                for name, entry in content["summary"].items()
            },
        }
    )


@dataclass(frozen=True)
class Failure:
    """A failed run.

    Attributes:
        error: one line.
        kind: a word or two.
        again: the command that repeats the run; "" if unknown.
    """

    error: str
    kind: str
    overrides: tuple[str, ...]
    again: str


def read_failure(run_dir: Path) -> Failure:
    """Raises UserError when the file is missing or damaged."""
    path = run_dir / FAILED
    content = read_json(path, RUN_BYTES)
    with reading(path, "the error of a failed run", AGAIN):
        check_failure(content)
    overrides = tuple(content["overrides"])
    return Failure(content["error"], content["kind"], overrides, content["again"])
