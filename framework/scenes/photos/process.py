"""The search for poses in a child process, and its result in the user's cache.

pycolmap writes to the screen, cannot be interrupted and may crash, hence the child process. It
writes a JSON object per line to its standard output: {"say": text}, {"say": text, "passing": true}
or {"error": text}. What libraries print goes to a file, whose last line explains a crash.

Results are made in a work folder, under its lock, and renamed when they are complete. So an
interrupted search leaves nothing, and of two processes with the same photos one searches.
"""

import json
import logging
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import IO, TextIO

from framework.compute.parallel import threads
from framework.compute.stopwatch import duration
from framework.errors import UserError
from framework.files.cache import cache_dir
from framework.files.locks import Busy, locked
from framework.scenes.photos.networks import require_networks
from framework.scenes.photos.options import LEARNED
from framework.scenes.photos.result import FILE
from framework.scenes.photos.source import Source

MODULE = "framework.scenes.photos.search"
ROOT = Path(__file__).resolve().parents[3]
PREFIX = "fishersplat-poses-"

log = logging.getLogger(__name__)


def poses_folder(source: Source) -> Path:
    """The folder in the user's cache with `sparse/0`, `images` and `poses.json` of the source.

    Raises:
        UserError: too few photos can be placed.
    """
    folder = cache_dir() / "poses" / f"{PREFIX}{source.key}"
    if _is_complete(folder):
        return folder
    work = folder.with_name(f".{folder.name}.work")  # kept: others may be waiting for its lock
    with ExitStack() as stack:
        try:
            stack.enter_context(locked(work))
        except Busy as busy:
            log.info("scene=photos: waiting for another process to find the poses: %s", busy)
            stack.enter_context(locked(work, wait=True))
        if not _is_complete(folder):
            _search(source, work / "made", folder)
    return folder


def _is_complete(folder: Path) -> bool:
    return (folder / FILE).is_file() and all((folder / n).is_dir() for n in ("images", "sparse"))


def _search(source: Source, work: Path, folder: Path) -> None:
    """Search in `work` and rename it to `folder`."""
    shutil.rmtree(work, ignore_errors=True)  # of a killed process
    try:
        work.mkdir()
        run_child(source, work)
        for path in work.rglob("*"):  # a power failure must not leave empty files after the rename
            if path.is_file():
                with path.open("rb") as file:
                    os.fsync(file.fileno())
        if folder.exists():  # incomplete
            shutil.rmtree(folder)
        os.rename(work, folder)
    finally:
        shutil.rmtree(work, ignore_errors=True)


def run_child(source: Source, folder: Path) -> None:
    """Find the poses of `source` in a child process and leave the result in `folder`.

    The child ends with this process, and when this is interrupted.

    Raises:
        UserError: the networks to match with are absent, or the child reported an error or crashed.
    """
    if source.matching == LEARNED:
        require_networks()
    request = {
        "folder": str(folder),
        "files": [str(file) for file in source.files],
        "video": source.video,
        "side": source.side,
        "frames": source.frames,
        "matching": source.matching,
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
            child.kill()  # interrupted; harmless if it has ended
            child.wait()


def _listen(child: subprocess.Popen[str], request: str, source: Source, printed: IO[str]) -> None:
    """Log the child's messages until it ends."""
    assert child.stdin is not None and child.stdout is not None, "both are pipes"
    with child.stdin, child.stdout:
        child.stdin.write(request)
        child.stdin.close()
        for line in child.stdout:
            message = json.loads(line)
            if "error" in message:
                raise UserError(message["error"])
            passing = {"passing": message.get("passing", False)}
            log.info(f"scene=photos: {message['say']}", extra=passing)
    if child.wait() != 0:
        printed.seek(0)
        lines = printed.read().strip().splitlines() or ["it printed nothing"]
        raise UserError(
            f"{source.folder}: expected pycolmap to find poses, but its process ended with"
            f" {child.returncode} ({lines[-1][:200]}); try other photos, or make the poses yourself"
            " and use scene=colmap"
        )


class Messages:
    """Sends messages to the parent process.

    label: starts the lines of counters, which are sent every `period_s` seconds.
    """

    def __init__(self, out: TextIO, period_s: float) -> None:
        self._out, self._period_s = out, period_s
        self._sent_at = time.monotonic()
        self.label = "poses"

    def say(self, text: str) -> None:
        """Send a line that stays on the screen."""
        self._send({"say": text})

    def error(self, text: str) -> None:
        """Send the error that ends the search."""
        self._send({"error": text})

    def counter(self, what: str) -> Callable[[int, int], None]:
        """Return a function of (done, total) that reports them with the time left."""
        started = time.monotonic()

        def count(done: int, total: int) -> None:
            now = time.monotonic()
            if now - self._sent_at < self._period_s:
                return
            self._sent_at = now
            left = (now - started) / done * (total - done) if done else 0.0
            rest = f", {duration(left)} left" if left >= 1 else ""
            self._send({"say": f"{self.label}: {done} of {total} {what}{rest}", "passing": True})

        return count

    def _send(self, message: dict[str, object]) -> None:
        print(json.dumps(message), file=self._out, flush=True)
