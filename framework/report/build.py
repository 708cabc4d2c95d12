"""From a study's folder to `report.md` and its figures beside it."""

from __future__ import annotations

from pathlib import Path

from framework.files import write_whole
from framework.report.collect import collect
from framework.report.figures import draw_curves
from framework.report.images import draw_images
from framework.report.markdown import render

REPORT = "report.md"


def build_report(study_dir: Path, title: str | None = None) -> Path:
    """Rebuild the report of all runs below `study_dir`; returns the path of `report.md`.

    title: the heading, else the folder's name. Raises UserError when there is no run to report or
    a record is damaged.
    """
    study = collect(study_dir)
    figures = [
        figure
        for scene in study.scenes
        for figure in (draw_images(study, scene), draw_curves(study, scene))
        if figure is not None
    ]
    text = render(study, figures, title or study_dir.resolve().name)
    write_whole(study_dir / REPORT, text)
    return study_dir / REPORT
