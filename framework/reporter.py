"""A process beside a lone run that imports what its report needs, and builds it at the end.

pandas and matplotlib take a second to import. Here that second passes on another core while the
run itself imports torch; in a study of many runs it is nothing, and all cores are busy. Whatever
goes wrong in the process beside, the report is built without it, and the error is told then.
"""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from framework import parallel
from framework.collector import import_uncollected
from framework.orphans import watch

ROOT = Path(__file__).resolve().parent.parent
MODULES = ("framework.report", "pandas", "matplotlib.backends.backend_svg", "PIL.WebPImagePlugin")

_beside: list[subprocess.Popen[str]] = []  # at most one


def start() -> None:
    """Start the process beside, if there is a core for it."""
    if _beside or parallel.threads() < 2:
        return
    paths = [str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])]
    with contextlib.suppress(OSError):  # no process, no memory: the report can do without
        _beside.append(
            subprocess.Popen(
                [sys.executable, "-P", "-m", "framework.reporter", str(os.getpid())],
                env={**os.environ, "PYTHONPATH": os.pathsep.join(paths)},
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
                encoding="utf-8",
                start_new_session=True,  # Ctrl-C is for the run; this one ends with its input
            )
        )


@contextmanager
def ended() -> Iterator[None]:
    """Ends the process beside, if one was started."""
    try:
        yield
    finally:
        for process in _beside:
            process.kill()
            process.communicate()
        _beside.clear()


def build(folder: Path) -> Path:
    """`framework.report.build_report(folder)`, by the process beside if there is one."""
    made = _asked(_beside[0], folder) if _beside else None
    if made is not None:
        return made
    import_uncollected("framework.report")
    from framework.report import build_report

    return build_report(folder)


def _asked(process: subprocess.Popen[str], folder: Path) -> Path | None:
    """The report of `folder` as `process` built it; None if it could not."""
    assert process.stdin is not None and process.stdout is not None
    made: Path | None = None
    try:
        with contextlib.suppress(OSError, ValueError):  # it is gone, or something else answered
            process.stdin.write(json.dumps(str(folder)) + "\n")
            process.stdin.flush()
            answer = json.loads(process.stdout.readline())
            made = Path(answer) if isinstance(answer, str) else None
    finally:
        if made is None:  # it may not go on writing beside whoever comes next
            process.kill()
            process.wait()
    return made


def main(parent: int) -> None:
    """Build the report of every folder that a line of the input names; answer with its path, or
    with null. Ends with the process `parent`."""
    watch(parent)
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "w", encoding="utf-8")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # what else is printed is no answer
    for module in MODULES:
        import_uncollected(module)
    from framework.report import build_report

    for line in sys.stdin:
        made = None
        with contextlib.suppress(Exception):  # whoever asked does the same and meets it there
            made = str(build_report(Path(json.loads(line))))
        print(json.dumps(made), file=answers, flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]))
