"""Two hundred mutated files for every reader."""

import os
import sys
from pathlib import Path

import pytest

from tests.fuzz.readers import READERS
from tests.fuzz.worker import fuzz

CASES = int(os.environ.get("FUZZ_CASES", "200"))
SEED = int(os.environ.get("FUZZ_SEED", "1"))

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform != "linux", reason="the worker uses Linux resource limits"),
]


@pytest.mark.parametrize("reader", READERS)
def test_mutated_files_are_read_or_refused_in_one_line(reader: str, tmp_path: Path) -> None:
    outcomes = fuzz(tmp_path / "results", reader, CASES, SEED)
    assert [outcome for outcome in outcomes if outcome not in ("read", "refused")] == []
    assert len(outcomes) == CASES
