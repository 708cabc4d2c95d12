"""What lies in a run's folder to look at it: the page of `fishersplat view RUN --static` and the
flight of `fishersplat video RUN`, if somebody made them."""

from __future__ import annotations

import os
from pathlib import Path
from urllib.parse import quote

from framework.files.opened import is_file
from framework.records.run_files import VIDEOS, VIEW
from framework.report.parts.document import Link
from framework.report.study.runs import ReportRun, Study

OPEN = (
    "`fishersplat view FOLDER` opens a run in the browser; with `--static` its page is kept in that"
    " folder, and a report that is built afterwards links it."
)


def folder_target(study: Study, run: ReportRun) -> str:
    """The run's folder as a link from the report."""
    return quote(os.fsencode(study.folder_of(run.run.run_dir))) + "/"


def view_link(study: Study, run: ReportRun) -> Link | None:
    """To the run's page; None without one, or where the report links no runs."""
    return _link(study, run, "in 3D", (VIEW,))


def video_link(study: Study, run: ReportRun) -> Link | None:
    """To the run's video; None without one, or where the report links no runs."""
    return _link(study, run, "video", VIDEOS)


def video_file(run: ReportRun) -> Path | None:
    """The run's video; None without one."""
    files = [run.run.run_dir / name for name in VIDEOS]
    return next((file for file in files if is_file(file)), None)


def _link(study: Study, run: ReportRun, text: str, names: tuple[str, ...]) -> Link | None:
    there = [name for name in names if is_file(run.run.run_dir / name)]
    if not study.linked or not there:
        return None
    return Link(text, folder_target(study, run) + there[0])
