"""A render and its gradients have the same bits on any number of threads and in any process."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from tests.laws.render_bits import render_bits

ROOT = Path(__file__).parents[2]


def test_same_bits_for_any_thread_count() -> None:
    digests = {threads: render_bits(threads) for threads in (1, 2, 3)}
    again = {threads: render_bits(threads) for threads in (3, 1, 2)}
    assert len({*digests.values(), *again.values()}) == 1, (digests, again)


def test_same_bits_in_another_process_with_a_cold_cache(tmp_path: Path) -> None:
    """The child compiles every kernel anew."""
    command = [sys.executable, "-m", "tests.laws.render_bits", "2"]
    child = subprocess.run(
        command,
        cwd=ROOT,
        env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert child.returncode == 0, child.stderr
    assert any(tmp_path.rglob("*.nbi")), "the child did not compile into its own cache"
    assert child.stdout.strip() == render_bits(1)
