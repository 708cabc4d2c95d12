"""The process that finds the poses, seen from its parent.

pycolmap writes to the screen, cannot be interrupted and may end its process on bad luck, hence a
process of its own. It tells one JSON object a line: {"say": text}, {"say": text, "passing": true}
or {"error": text}; what libraries print goes to a file whose last line explains a sudden end.
"""

from __future__ import annotations

import json
import logging
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import IO

from framework.compute.parallel import threads
from framework.errors import UserError
from framework.scenes.photos.source import Source

MODULE = "framework.scenes.photos.search"
ROOT = Path(__file__).resolve().parents[3]

log = logging.getLogger(__name__)


def run_child(source: Source, folder: Path) -> None:
    """Find the poses of `source` and leave the result in `folder`. Raises UserError with what the
    child found wrong. The child ends with this process, and when this is interrupted."""
    request = {
        "folder": str(folder),
        "files": [str(file) for file in source.files],
        "video": source.video,
        "side": source.side,
        "frames": source.frames,
        "copies": source.copies,
        "threads": threads(),
        "parent": os.getpid(),
        "period_s": 1.0 if sys.stdout.isatty() else 10.0,
    }
    paths = [str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])]
    with tempfile.TemporaryFile("w+", errors="replace") as printed:
        child = subprocess.Popen(
            [sys.executable, "-m", MODULE],
            env={**os.environ, "PYTHONPATH": os.pathsep.join(paths)},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=printed,
            text=True,
        )
        try:
            _listen(child, json.dumps(request), source, printed)
        finally:
            child.kill()  # interrupted; harmless where it has ended
            child.wait()


def _listen(child: subprocess.Popen[str], request: str, source: Source, printed: IO[str]) -> None:
    """Pass on what the child tells until it ends."""
    assert child.stdin is not None and child.stdout is not None, "both are pipes"
    with child.stdin, child.stdout:
        child.stdin.write(request)
        child.stdin.close()
        for line in child.stdout:
            told = json.loads(line)
            if "error" in told:
                raise UserError(told["error"])
            text = f"scene=photos: {told['say']}"
            log.info(text, extra={"passing": told.get("passing", False)})
    if child.wait() != 0:
        printed.seek(0)
        lines = printed.read().strip().splitlines() or ["it printed nothing"]
        raise UserError(
            f"{source.folder}: expected pycolmap to find poses, but its process ended with"
            f" {child.returncode} ({lines[-1][:200]}); try other photos, or make the poses yourself"
            " and use scene=colmap"
        )
