"""Mutated inputs of every reader, for as long as you like; the test suite does a few hundred.

    python benchmarks/safety/fuzz.py --cases 1000 --seed 1 [--output benchmarks/results/fuzz.md]

Prints a summary, and writes it to the file of `--output`; exits with 1 and prints the cases if
there is a bug: anything but a read or the documented one-line error, a crash, 5 s of CPU time,
60 s by the clock, or 1 GiB of memory.
"""

from __future__ import annotations

import argparse
import resource
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from tests.fuzz.drive import Tally, fuzz  # noqa: E402
from tests.fuzz.readers import READERS  # noqa: E402


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=200, help="of each reader")
    parser.add_argument("--seed", type=int, default=0, help="other mutations")
    parser.add_argument("--only", help="names of readers, by commas")
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    readers = options.only.split(",") if options.only else list(READERS)
    with tempfile.TemporaryDirectory() as folder:
        tally = fuzz(Path(folder) / "results", readers, options.cases, options.seed)
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = f"python benchmarks/safety/fuzz.py --cases {options.cases} --seed {options.seed}"
    command += f" --only '{options.only}'" if options.only else ""
    text = _report(tally, command, used.ru_utime + used.ru_stime)
    print(*tally.bugs, text, sep="\n")
    if options.output is not None:
        options.output.write_text(text + below(options.output), encoding="utf-8")
    return 1 if tally.bugs else 0


def below(path: Path) -> str:
    """What stands below the tables that are made here: from the first heading on."""
    old = path.read_text(encoding="utf-8") if path.is_file() else ""
    at = old.find("\n## ")
    return old[at:] if at >= 0 else ""


def _report(tally: Tally, command: str, cpu_s: float) -> str:
    kinds = ("read", "refused", "bug")
    rows = [
        f"| {reader} | {' | '.join(str(counts[kind]) for kind in kinds)} |"
        f" {tally.slowest_s[reader]:.2f} |"
        for reader, counts in tally.counts.items()
    ]
    lines = [
        f"`{command}`",
        "",
        "| reader | read | refused in one line | crash, hang, memory, other error"
        " | slowest, CPU s |",
        "|---|---|---|---|---|",
        *rows,
        "",
        f"{tally.cases} cases, of which {tally.special} had a pipe, a folder, a link or the like in"
        f" the file's place; {len(tally.bugs)} bugs, {cpu_s:.0f} s of CPU time.",
    ]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.exit(main())
