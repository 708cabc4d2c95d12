"""A run's warnings reach its record, the report's first screen and the page of the run."""

from __future__ import annotations

import json
from pathlib import Path

from framework.records.record import POSE_CHECK, read_record
from framework.report import build_report
from tests.record.fakes import fake_run

TEXT = "scene=llff: the poses do not seem to fit the photos"


def _doubt(run_dir: Path) -> None:
    file = run_dir / "record.json"
    content = json.loads(file.read_text())
    content["warnings"] = [TEXT]
    content["provenance"][POSE_CHECK] = {"support": 0.2, "chance": 0.2, "ratio": 1.0, "fits": False}
    file.write_text(json.dumps(content))


def test_verdict_and_notes_name_the_warning_and_the_scene(tmp_path: Path) -> None:
    runs = [fake_run(tmp_path, seed=seed) for seed in (0, 1)]
    _doubt(runs[0])
    assert read_record(runs[0] / "record.json").warnings == (TEXT,)
    report = build_report(tmp_path).read_text()
    verdict = report.split("\n\n")[1]
    assert "Caution: the poses do not seem to fit the photos of embedded." in verdict
    assert f"1 of 2 runs): {TEXT}" in report


def test_other_warnings_reach_the_verdict_too(tmp_path: Path) -> None:
    run = fake_run(tmp_path)
    content = json.loads((run / "record.json").read_text())
    content["warnings"] = ["scene=photos: 2 photos were placed by few points, so perhaps wrongly"]
    (run / "record.json").write_text(json.dumps(content))
    report = build_report(tmp_path).read_text()
    assert "Caution: see the warnings about embedded below." in report.split("\n\n")[1]
    assert "placed by few points" in report


def test_records_without_warnings_are_read(tmp_path: Path) -> None:
    file = fake_run(tmp_path) / "record.json"
    content = json.loads(file.read_text())
    del content["warnings"]
    file.write_text(json.dumps(content))
    assert read_record(file).warnings == ()
