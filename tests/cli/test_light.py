"""Help, configuration and errors answer at once: nothing heavy is imported for them."""

import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest

from framework.command.config.schema import ROOT

HEAVY = ("torch", "numba", "pandas", "matplotlib", "scipy", "skimage", "cv2", "pycolmap", "kornia")
REPORT_HEAVY = f"""
import sys
from framework.command.cli import main
code = main(sys.argv[1:])
print("HEAVY", [name for name in {HEAVY} if name in sys.modules])
sys.exit(code)
"""
LIMIT_S, LIMIT_IMPORTS = 1.5, 6.0  # of CPU; in imports of Hydra, which a busy machine slows too


@pytest.mark.parametrize(
    ("line", "code", "expected"),
    [
        ("--help", 0, "uar_hard"),
        ("--cfg job", 0, "name: embedded"),
        ("trainer.steps=0", 2, "trainer.steps"),
    ],
)
def test_it_answers_at_once(tmp_path: Path, line: str, code: int, expected: str) -> None:
    """CPU time, the best of three: a busy machine can only add to it."""
    times: list[float] = []
    limit = LIMIT_S
    while len(times) < 3 and min(times, default=limit) >= limit:
        done, cpu_s = _answer(tmp_path, REPORT_HEAVY, line)
        assert done.returncode == code, done.stderr
        assert expected in done.stdout + done.stderr
        assert "HEAVY []" in done.stdout
        times.append(cpu_s)
        if cpu_s >= limit:
            limit = max(limit, LIMIT_IMPORTS * _answer(tmp_path, "import hydra.main", "")[1])
    assert min(times) < limit


def _answer(tmp_path: Path, code: str, line: str) -> tuple[subprocess.CompletedProcess[str], float]:
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        [sys.executable, "-c", code, *line.split()],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT), "FISHERSPLAT_CACHE": str(tmp_path / "cache")},
        capture_output=True,
        text=True,
        timeout=60,
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return done, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
