"""`python -m framework.report STUDY_DIR`: rebuild a study's report from its records."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from framework.errors import UserError


def main(arguments: list[str] | None = None) -> int:
    """Exit status: 0, or 2 with one line on stderr for bad input."""
    parser = argparse.ArgumentParser(prog="python -m framework.report", description=__doc__)
    parser.add_argument("study_dir", type=Path, help="folder of the study, as reports/embedded")
    parser.add_argument("--title", help="heading of the report (default: the folder's name)")
    options = parser.parse_args(arguments)
    from framework.report.build import build_report

    try:
        path = build_report(options.study_dir, options.title)
    except UserError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(f"report: {path}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
