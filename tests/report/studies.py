"""Made-up studies of many records: few distinct runs, written once and copied."""

from __future__ import annotations

import json
import shutil
import tempfile
from pathlib import Path

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
