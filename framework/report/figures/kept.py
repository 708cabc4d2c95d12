"""Figures that an earlier report of the same runs drew, while their folders were there."""

from __future__ import annotations

from framework.files.opened import is_file
from framework.report.parts.document import Picture
from framework.report.study.runs import Study

KINDS = ("jpg", "png", "svg")
CAPTION = "Drawn when the runs were made, with the names and colours of the report of that time."


def kept(study: Study, name: str, scene: str) -> Picture | None:
    """The files of that name beside the report, without their extension; None where none is."""
    files = tuple(f"{name}.{kind}" for kind in KINDS if is_file(study.out_dir / f"{name}.{kind}"))
    return Picture(files, f"{name.partition('_')[0]} of {scene}", CAPTION) if files else None
