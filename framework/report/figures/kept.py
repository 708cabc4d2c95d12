"""Figures that an earlier report of the same runs drew, while their folders were there."""

from __future__ import annotations

from framework.files.opened import is_file
from framework.report.parts.document import Picture
from framework.report.study.runs import Study

ENDS = ("jpg", "png", "svg")
CAPTION = "Drawn when the runs were made, with the names and colours of the report of that time."


def kept(study: Study, kind: str, scene: str) -> Picture | None:
    """The files of that kind of figure beside the report; None where none is."""
    name = study.file_of(kind, scene)
    files = tuple(f"{name}.{end}" for end in ENDS if is_file(study.out_dir / f"{name}.{end}"))
    return Picture(files, f"{kind} of {scene}", CAPTION) if files else None
