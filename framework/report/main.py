"""`fishersplat report DIR [DIR ...]`: rebuild a report from the records of its runs.

Several folders are reported as one study; `--out` says where that report goes.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

from framework.errors import (
    Arguments,
    UserError,
    machine_line,
    printable_line,
    require,
)
from framework.files.limits import check_address_space

BASELINE_HELP = (
    "method that the others are compared with, by its display or registry name, as uar (default:"
    " plain training)"
)


def main(arguments: list[str], prog: str) -> int:
    """Exit status: 0, or 2 with one line on stderr for bad input, or if no run has finished."""
    parser = Arguments(prog=prog, description=__doc__)
    parser.add_argument(
        "study_dirs", type=Path, nargs="+", metavar="DIR", help="folder of a study, as reports/demo"
    )
    parser.add_argument("--out", type=Path, help="folder of the report (default: the only DIR)")
    parser.add_argument("--title", help="heading of the report (default: its folder's name)")
    parser.add_argument(
        "--without-photos",
        action="store_true",
        help="no pictures but of the embedded scene and no links to the runs: for a report that is"
        " passed on where photos may not be",
    )
    parser.add_argument("--baseline", default="", metavar="METHOD", help=BASELINE_HELP)

    def report() -> int:
        options = parser.parse_args(arguments)
        require(
            options.out is not None or len(options.study_dirs) == 1,
            f"--out: expected a folder for the report of {len(options.study_dirs)} studies, got"
            " none; add --out DIR",
        )
        check_address_space()
        _check_place(options.out or options.study_dirs[0])
        from framework.report.build import built

        photos = not options.without_photos
        made = built(options.study_dirs, options.title, options.out, photos, options.baseline)
        tell("report", made.path, made.verdict)
        require(
            len(made.study.runs) > 0,
            f"{made.path.parent}: expected a finished run, got {len(made.study.failed)} failed or"
            " damaged; the report says why",
        )
        return 0

    return exit_code(report)


def tell(kind: str, path: Path, verdict: str) -> None:
    """Print the verdict of a report, the path of its page and its own."""
    if verdict:
        print(printable_line(verdict))
    print(f"page: {printable_line(str(path.with_suffix('.html')))}")
    print(f"{kind}: {printable_line(str(path))}")


def exit_code(command: Callable[[], int]) -> int:
    """What `command` returns; 2 with one line on stderr for bad input or a machine's error."""
    try:
        return command()
    except UserError as error:
        print(f"error: {error}", file=sys.stderr)
    except Exception as error:
        line = machine_line(error)
        if line is None:
            raise
        print(f"error: {line}", file=sys.stderr)
    return 2


def _check_place(out_dir: Path) -> None:
    """Raise UserError for a report inside a study, in the folder of a run or of all runs."""
    from framework.records import RUN_FOLDERS
    from framework.report.study.collect import run_dirs

    place = out_dir.resolve()
    if RUN_FOLDERS not in place.parts:  # nor is a large folder searched
        return
    studies = {run.parent.parent for run in run_dirs(place) if run.parent.name == RUN_FOLDERS}
    for study in studies.intersection(place.parents):
        raise UserError(
            f"{out_dir}: expected the folder of a study for its report, got one of its runs; give"
            f" {study}, or --out DIR"
        )
