"""Reads mutated files of one reader in a separate process, with limits of memory and time.

    python -m tests.fuzz.worker RESULTS READER CASES SEED

For every case a line goes into RESULTS before it is read and another one with the outcome: `read`,
`refused` (the documented error in one line), or anything else, which is a bug. A case may take 5 s
of CPU time (SIGPROF ends the process), 60 s by the clock (SIGALRM) and 1 GiB more than the valid
example.
"""

import contextlib
import os
import resource
import signal
import subprocess
import sys
import tempfile
import traceback
from pathlib import Path

from framework.command.config.schema import ROOT
from framework.compute.rng import stream
from framework.errors import LONGEST
from tests.fuzz.mutate import mutate, put_back, put_special
from tests.fuzz.readers import READERS, Reader

CPU_S = 5.0
WAIT_S = 60.0
SPECIAL = 0.06  # share of cases with something else than a file in the file's place
MEMORY = 1 << 30


def fuzz(results: Path, reader: str, cases: int, seed: int) -> list[str]:
    """Read mutated files in a worker; the outcome of each case, the last one of a crash."""
    command = [sys.executable, "-m", "tests.fuzz.worker", str(results), reader]
    code = subprocess.call([*command, str(cases), str(seed)], cwd=ROOT)
    begun, *outcomes = results.read_text(encoding="utf-8").split("begun\n")
    assert begun == "", "the worker failed before its first case"
    return [outcome.strip() or f"the process ended with {code}" for outcome in outcomes]


def main(arguments: list[str]) -> None:
    results, name, cases, seed = arguments
    reader = READERS[name]
    with tempfile.TemporaryDirectory() as built, open(results, "w", encoding="utf-8") as out:
        folder = Path(built)
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # libraries complain there
        reader.make(folder)
        reader.read(folder)
        files = {file: (folder / file).read_bytes() for file in reader.files}
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        limit = pages * resource.getpagesize() + MEMORY
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
        for index in range(int(cases)):
            draw = stream(int(seed), f"fuzz/{name}/{index}")
            file = list(files)[int(draw.integers(len(files)))]
            if draw.random() < SPECIAL:
                put_special(folder / file, draw)
            else:
                (folder / file).write_bytes(mutate(file, files[file], draw))
            print("begun", file=out, flush=True)
            print(" ".join(_outcome(reader, folder).split()), file=out, flush=True)
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
