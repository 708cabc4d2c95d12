"""A process that reads mutated files, within limits of memory and time.

    python -m tests.fuzz.worker RESULTS SEED FIRST LAST READER...

For every reader and number from FIRST to LAST - 1 a line goes into RESULTS before the case and one
with its outcome after it; so whoever started this process sees at which case it died.
`read`: the reader took it. `refused`: its documented error, one line. All else is a bug.
A case may take 5 s of CPU time (SIGPROF ends the process), 60 s by the clock (SIGALRM) and 1 GiB
beyond what the process had after reading every valid example.
"""

from __future__ import annotations

import contextlib
import json
import os
import resource
import signal
import sys
import tempfile
import time
import traceback
from pathlib import Path

import numpy as np

from framework.compute.rng import stream
from framework.errors import LONGEST
from tests.fuzz.mutate import mutate
from tests.fuzz.readers import READERS, Reader
from tests.fuzz.special import put_back, put_special

CPU_S = 5.0
WAIT_S = 60.0  # by the clock: for a pipe to which nobody writes, say
SPECIAL = 0.06  # of the cases have something in the file's place that is no file
MEMORY = 1 << 30


def main(arguments: list[str]) -> None:
    results, seed, first, last, *names = arguments
    with tempfile.TemporaryDirectory() as folder, open(results, "a", encoding="utf-8") as out:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # libpng and its like complain there
        pristine = {name: _prepare(READERS[name], Path(folder) / name) for name in names}
        _limit_memory()
        for name in names:
            for index in range(int(first), int(last)):
                draw = stream(int(seed), f"fuzz/{name}/{index}")
                special = bool(draw.random() < SPECIAL)
                begun = {"reader": name, "index": index, "special": special}
                print(json.dumps(begun), file=out, flush=True)
                since = time.process_time()
                outcome = _case(name, Path(folder) / name, pristine, special, draw)
                ended = {"outcome": outcome, "cpu_s": time.process_time() - since}
                print(json.dumps(ended), file=out, flush=True)


def _prepare(reader: Reader, folder: Path) -> dict[str, bytes]:
    """Write the valid example and read it; the bytes of its files."""
    folder.mkdir()
    reader.make(folder)
    reader.read(folder)
    return {name: (folder / name).read_bytes() for name in reader.files}


def _limit_memory() -> None:
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limit = pages * resource.getpagesize() + MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))


def _case(
    name: str,
    folder: Path,
    pristine: dict[str, dict[str, bytes]],
    special: bool,
    draw: np.random.Generator,
) -> str:
    files = pristine[name]
    file = list(files)[int(draw.integers(len(files)))]
    others = [data for other in pristine.values() for data in other.values()]
    if special:
        put_special(folder / file, draw)
    else:
        (folder / file).write_bytes(mutate(file, files[file], others, draw))
    try:
        return _outcome(READERS[name], folder)
    finally:
        put_back(folder / file, files[file])


def _outcome(reader: Reader, folder: Path) -> str:
    signal.setitimer(signal.ITIMER_PROF, CPU_S)
    signal.setitimer(signal.ITIMER_REAL, WAIT_S)
    try:
        with contextlib.redirect_stdout(None):
            reader.read(folder)
    except reader.refusals as error:
        text = str(error)
        whole = "\n" not in text and 0 < len(text) <= LONGEST
        return "refused" if whole or reader.refusals[0] is ValueError else f"message: {text[:900]}"
    except BaseException as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        return f"{type(error).__name__} at {Path(place.filename).name}:{place.lineno}: {error}"
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.setitimer(signal.ITIMER_REAL, 0)
    return "read"


if __name__ == "__main__":
    main(sys.argv[1:])
