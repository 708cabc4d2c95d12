"""Made-up studies of many records: few distinct runs, written once and copied."""

from __future__ import annotations

import csv
import hashlib
import json
import shutil
import tempfile
from pathlib import Path

from framework.records.provenance import ROOT
from framework.report.study.collect import collect
from tests.record.fakes import fake_run

METHODS = (("none", "none"), ("none", "uar"), ("safi", "none"), ("safi", "uar"))
DISTINCT = 4  # seeds of which the images and metrics differ


def write_study(folder: Path, scenes: int, seeds: int) -> int:
    """Write `METHODS` on so many scenes with so many seeds; returns the number of records."""
    with tempfile.TemporaryDirectory() as source:
        made = {
            (method, seed): fake_run(Path(source), *method, seed=seed)
            for method in METHODS
            for seed in range(DISTINCT)
        }
        for scene in range(scenes):
            for method in METHODS:
                for seed in range(seeds):
                    run = folder / "runs" / f"scene{scene}-{'-'.join(method)}-s{seed}"
                    shutil.copytree(made[method, seed % DISTINCT], run)
                    _rename(run / "record.json", f"scene{scene}", seed)
    return scenes * seeds * len(METHODS)


def _rename(record: Path, scene: str, seed: int) -> None:
    content = json.loads(record.read_text(encoding="utf-8"))
    content["config"]["seed"] = seed
    content["config"]["scene"]["name"] = scene
    content["scene"] |= {"name": scene, "fingerprint": scene.encode().hex()}
    record.write_text(json.dumps(content), encoding="utf-8")


def write_committed(folder: Path, name: str) -> None:
    """Records with the PSNR of a committed study, as far as its methods are pairs of augmenter and
    regularizer."""
    runs = collect(ROOT / "reports" / "committed" / name).runs
    rows = [
        {"method": run.method, "scene": run.scene, "seed": run.seed, "psnr": run.mean("psnr")}
        for run in runs
        if "," not in run.method
    ]
    with tempfile.TemporaryDirectory() as source:
        made = {
            method: fake_run(Path(source), *method.split(" + "), seed=0)
            for method in sorted({row["method"] for row in rows})
        }
        for row in rows:
            run = (
                folder
                / "runs"
                / f"{row['scene']}-{row['method'].replace(' + ', '-')}-{row['seed']}"
            )
            shutil.copytree(made[row["method"]], run)
            _rename(run / "record.json", row["scene"], int(row["seed"]))
            _set_psnr(run, float(row["psnr"]))


def _set_psnr(run: Path, psnr: float) -> None:
    """Shift every view, so that the mean is this."""
    record = json.loads((run / "record.json").read_text(encoding="utf-8"))
    shift = psnr - record["summary"]["psnr"]["mean"]
    record["summary"]["psnr"]["mean"] = psnr
    record["parameters_sha256"] = hashlib.sha256(f"{psnr}".encode()).hexdigest()
    (run / "record.json").write_text(json.dumps(record), encoding="utf-8")
    with (run / "metrics.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    with (run / "metrics.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(row | {"psnr": float(row["psnr"]) + shift} for row in rows)
