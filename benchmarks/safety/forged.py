"""Forged checkpoints of every plugin. Exits with 1 if one is neither refused in one line nor used.

A training with each plugin keeps a checkpoint; then each kind of number, text, name, key and tensor
of the plugin's part of it is changed, under a right checksum, and the run goes on; with three of
them at once, all of the state. Either the
checkpoint is refused in one line, as a damaged one, or the training ends, or it says in one line
that it diverged.

    python benchmarks/safety/forged.py [--only uar,adc]
"""

from __future__ import annotations

import argparse
import logging
import sys
import tempfile
import traceback
import warnings
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from tests.contract.test_training import ACTING, ALL  # noqa: E402
from tests.security.forged import Forged, Forgery, forgeries  # noqa: E402


class Lines(logging.Handler):
    """Counts the lines that are told."""

    told = 0

    def emit(self, record: logging.LogRecord) -> None:
        self.told += 1 + record.getMessage().count("\n")


def outcome(forgery: Forgery, forged: Forged, lines: Lines) -> str:
    """`refused`, `used`, or what is wrong."""
    _, tree, tensors = forged
    lines.told = 0
    try:
        state = forgery.read(tree, tensors)
        if state is None:
            return "refused" if lines.told == 1 else f"refused in {lines.told} lines"
        forgery.goes_on(state)
    except Exception as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        return f"{type(error).__name__} at {Path(place.filename).name}:{place.lineno}: {error}"
    return "used"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", default="", help="names of plugins, by commas")
    given = parser.parse_args()
    wanted = [({group: name}, "plugins") for group, name in ALL] + [(ACTING, "")]
    if given.only:
        wanted = [one for one in wanted if {*one[0].values()} & {*given.only.split(",")}]
    lines, total = Lines(), Counter[str]()
    log = logging.getLogger("framework")
    log.addHandler(lines)
    log.propagate = False
    warnings.simplefilter("ignore")  # of values beyond float32
    print("| plugin | refused in one line | used | other |", "|---|---|---|---|", sep="\n")
    for names, below in wanted:
        counts, wrong = Counter[str](), list[str]()
        with tempfile.TemporaryDirectory() as folder:
            forgery = Forgery(Path(folder), names)
            for forged in forgeries(forgery, below):
                found = outcome(forgery, forged, lines)
                kind = found if found in ("refused", "used") else "other"
                counts[kind] += 1
                wrong += [f"{forged[0]}: {found}"] * (kind == "other")
        row = " | ".join(str(counts[kind]) for kind in ("refused", "used", "other"))
        print(
            f"| {' '.join(f'{group}={name}' for group, name in names.items())} | {row} |",
            *wrong,
            sep="\n",
            flush=True,
        )
        total += counts
    print(f"\n{total.total()} forged checkpoints, {total['other']} faults.")
    return int(total["other"] > 0)


if __name__ == "__main__":
    raise SystemExit(main())
