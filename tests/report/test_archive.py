"""A study's runs.jsonl rebuilds its report when the runs' folders are gone."""

import json
import shutil
from pathlib import Path

import pytest

from framework.errors import UserError
from framework.records.archive import ARCHIVE, read_archive
from framework.records.record import write_failed
from framework.report import build_report
from framework.report.study.collect import collect
from tests.record.fakes import fake_run, make_config


@pytest.fixture
def study(tmp_path: Path) -> Path:
    for seed in range(3):
        fake_run(tmp_path, seed=seed)
        fake_run(tmp_path, "safi", "uar", seed=seed, gain=0.5)
    failed = tmp_path / "runs" / "broken"
    write_failed(
        failed, make_config("dba", seed=0), ["augment=dba"], "no overlap", "bad input", "x"
    )
    build_report(tmp_path)
    return tmp_path


def _figures(study: Path) -> list[tuple[object, ...]]:
    actual = collect(study)
    runs = [
        (r.scene, r.method, r.seed, r.mean("psnr"), r.record.gaussians, tuple(r.psnr.items()))
        for r in actual.runs
    ]
    return [*runs, *((r.method, r.kind, r.record.error, r.again) for r in actual.failed)]


def test_an_archive_holds_what_the_runs_hold(study: Path, tmp_path: Path) -> None:
    before = _figures(study)
    text = (study / ARCHIVE).read_text()
    shutil.rmtree(study / "runs")
    assert _figures(study) == before
    report = build_report(study, out_dir=tmp_path / "again").path.read_text()
    assert "no pictures" in report and "broken" in report and "Worst case" in report
    assert (tmp_path / "again" / ARCHIVE).read_text() == text


def test_an_archive_of_other_runs_is_not_overwritten(study: Path) -> None:
    shutil.rmtree(study / "runs" / "embedded-safi-uar-s0")
    with pytest.raises(UserError, match="got 1 others"):
        build_report(study)


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        ({"schema": 2}, "schema 2"),
        ({"record": {}}, "identity is"),
    ],
)
def test_a_damaged_line_is_named(study: Path, damage: dict[str, object], message: str) -> None:
    first, *rest = (study / ARCHIVE).read_text().splitlines()
    lines = [first, json.dumps(json.loads(rest[0]) | damage), *rest[1:]]
    (study / ARCHIVE).write_text("\n".join(lines))
    with pytest.raises(UserError, match=rf"in line 2.*{message}"):
        read_archive(study)
