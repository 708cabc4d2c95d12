"""`fishersplat view RUN [RUN]`: look at a run, or at two of one scene, in the browser.

A page on this machine only (127.0.0.1), or with --static a file that shows the same anywhere.
"""

from collections.abc import Sequence
from pathlib import Path

from framework.errors import Arguments, printable_line, require
from framework.records.run_files import VIEW

HTML = (".html", ".htm")


def main(arguments: Sequence[str], prog: str) -> int:
    """Exit status 0.

    Raises:
        UserError: for bad input.
    """
    parser = Arguments(prog=prog, description=__doc__)
    parser.add_argument(
        "runs",
        type=Path,
        nargs="+",
        metavar="RUN",
        help="folder of a run, as reports/STUDY/runs/RUN, or of a study with one, or a file"
        " RUN/export/scene.spz; two are compared",
    )
    parser.add_argument(
        "--static",
        type=Path,
        nargs="?",
        const=Path(),
        metavar="FILE.html",
        help=f"write one self-contained file and end (default: {VIEW} in the run's folder, which"
        " its report links)",
    )
    parser.add_argument("--port", type=int, default=0, help="of the local page (default: any)")
    parser.add_argument("--no-browser", action="store_true", help="open none, only say where")
    parser.add_argument(
        "--without-photos",
        action="store_true",
        help="Gaussians and cameras alone: for a page that is passed on where photos may not be",
    )
    options = parser.parse_args(arguments)
    require(
        len(options.runs) <= 2,
        f"view: expected one run or two, got {len(options.runs)}; name two to compare",
    )
    require(0 <= options.port <= 65535, f"--port: expected 0 to 65535, got {options.port}")
    target = None if options.static is None else _target(options.static, options.runs)
    from framework.records.spz_reader import SUFFIX
    from framework.view.page import view_page
    from framework.view.runs import check_together, find_run, read_exported, read_viewed

    runs = [
        read_exported(path) if path.suffix == SUFFIX else read_viewed(find_run(path))
        for path in options.runs
    ]
    check_together(runs)
    page = view_page(runs, not options.without_photos)
    if options.static is None:
        from framework.view.server import show

        show(page, options.port, not options.no_browser)
        return 0
    from framework.files.whole import write_whole

    target = target or runs[0].folder / VIEW
    write_whole(target, page)
    print(f"view: {printable_line(str(target))} ({len(page.encode()) / 1e6:.1f} MB)")
    return 0


def _target(static: Path, runs: Sequence[Path]) -> Path | None:
    """The file to write; None for the one in the run's folder. Raises UserError for another."""
    if static == Path():
        require(
            len(runs) == 1,
            "--static: expected a file for the page of two runs; add --static FILE.html",
        )
        return None
    require(
        static.suffix.lower() in HTML and not static.is_dir(),
        f"--static: expected a file name that ends in .html, got '{static}'; runs are named first",
    )
    return static
