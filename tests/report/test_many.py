"""A report of many records stays quick; `benchmarks/speed/report.py` measures a thousand."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from framework.report import build_report
from tests.report.studies import write_study

LIMIT_S = 8.0  # of CPU time; about 2 where the machine does nothing else


@pytest.mark.slow
def test_a_hundred_records(tmp_path: Path) -> None:
    assert write_study(tmp_path, scenes=1, seeds=25) == 100
    start = time.process_time()
    report = build_report(tmp_path)
    assert time.process_time() - start < LIMIT_S
    assert "(n = 25)" in report.read_text(encoding="utf-8")
