"""`fishersplat report DIR [DIR ...]`: rebuild a report from the records of its runs.

Several folders are reported as one study; `--out` says where that report goes.
"""

from pathlib import Path

from framework.errors import Arguments, printable_line, require
from framework.files.limits import check_address_space

BASELINE_HELP = (
    "method that the others are compared with, by its display or registry name, as uar (default:"
    " plain training)"
)


def main(arguments: list[str], prog: str) -> int:
    """The subcommand; exit status 0.

    Raises:
        UserError: for bad input, and if no run has finished.
    """
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

    options = parser.parse_args(arguments)
    require(
        options.out is not None or len(options.study_dirs) == 1,
        f"--out: expected a folder for the report of {len(options.study_dirs)} studies, got none;"
        " add --out DIR",
    )
    check_address_space()
    from framework.report.build import build_report

    photos = not options.without_photos
    report = build_report(options.study_dirs, options.title, options.out, photos, options.baseline)
    tell("report", report.path, report.verdict)
    require(
        len(report.study.runs) > 0,
        f"{report.path.parent}: expected a finished run, got {len(report.study.failed)} failed or"
        " damaged; the report says why",
    )
    return 0


def tell(kind: str, path: Path, verdict: str) -> None:
    """Print the verdict of a report, the path of its page and its own."""
    if verdict:
        print(printable_line(verdict))
    print(f"page: {printable_line(str(path.with_suffix('.html')))}")
    print(f"{kind}: {printable_line(str(path))}")
