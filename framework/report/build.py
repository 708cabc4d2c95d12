"""From the folders of one or more studies to `report.md`, `report.html`, tables and figures."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

from framework.errors import require
from framework.files.whole import make_folder, write_whole
from framework.records.archive import ARCHIVE, has_archive, read_archive
from framework.report.export import LATEX, TABLE, comparisons_tex, runs_archive, runs_csv
from framework.report.figures.images import remove_pictures
from framework.report.figures.views import DamagedRun, damaged_pictures, own_scenes
from framework.report.page import html as page
from framework.report.page import markdown
from framework.report.page.gallery import gallery
from framework.report.sections import document
from framework.report.statistics.outcomes import outcomes
from framework.report.study.collect import collect
from framework.report.study.folders import run_dirs
from framework.report.study.runs import Study

REPORT, PAGE = "report.md", "report.html"


def build_report(
    study_dirs: Path | Sequence[Path],
    title: str | None = None,
    out_dir: Path | None = None,
    photos: bool = True,
    rival: str = "",
) -> Path:
    """Rebuild the report of all runs below the folders; returns the path of `report.md`.

    title: the heading, else the name of the report's folder. out_dir: where the report goes, else
    the first folder. photos: show scenes and link to the runs; without, the embedded scene alone
    and no links, for a report that is passed on where photos may not be; pictures of an earlier
    report in that folder go. rival: the method that the others are compared with, by its name in
    the report, in the place of plain training. A run whose files are not what a run writes counts
    among the failed ones. Raises UserError when there is no run, or none of the rival.
    """
    return built(study_dirs, title, out_dir, photos, rival)[0]


def built(
    study_dirs: Path | Sequence[Path],
    title: str | None = None,
    out_dir: Path | None = None,
    photos: bool = True,
    rival: str = "",
) -> tuple[Path, Study]:
    """As `build_report`, with the study that the report is of."""
    broken: dict[Path, str] = {}
    while True:  # each time without another run; with forged sizes aside, twice at most
        study = collect(study_dirs, out_dir, broken, rival)
        if out_dir is None:
            _keep_fuller_report(study)
        study = replace(study, linked=study.linked and photos)
        try:
            return _build(study, title, photos), study
        except DamagedRun as error:
            broken |= damaged_pictures(study) or {error.run_dir: str(error)}


def _keep_fuller_report(study: Study) -> None:
    """Raise UserError where a report made of an archive, without pictures, would overwrite the one
    that was made of the runs."""
    require(
        study.out_dir not in study.archived or not (study.out_dir / REPORT).exists(),
        f"{study.out_dir}: expected runs, got only {ARCHIVE} beside a report that was made with the"
        " runs' pictures; add --out DIR to write another report",
    )


def _keep_other_archive(study: Study) -> None:
    """Raise UserError where the report would overwrite an archive with runs that are not in it, as
    that may be all that is left of them."""
    if not has_archive(study.out_dir):
        return
    folders = {folder.name for folder in run_dirs(study.out_dir)}
    reported = {run.run.run_dir.name for run in study.runs}
    lost = sorted(
        {entry.run.run_dir.name for entry in read_archive(study.out_dir)}
        - {run.run_dir.name for run in study.failed}
        - folders
        - reported
    )
    require(
        not lost,
        f"{study.out_dir / ARCHIVE}: expected runs of this report, got {len(lost)} others (as"
        f" {lost[0] if lost else ''}), whose folders are gone; write the report to another --out"
        " DIR, or delete that file",
    )


def _build(study: Study, title: str | None, photos: bool) -> Path:
    """The report of a study. Raises DamagedRun for a run with a picture that is none."""
    _keep_other_archive(study)
    make_folder(study.out_dir)
    shown = study.scenes if photos else own_scenes(study)
    if study.archived:  # the pictures went with the runs' folders
        shown = []
    if not photos:
        remove_pictures(study, shown)
    with ThreadPoolExecutor(1) as beside:  # photos are encoded while charts are drawn
        shots = beside.submit(gallery, study, shown)
        made = document(study, title or study.out_dir.resolve().name, shown)
        write_whole(study.out_dir / PAGE, page.render(made, shots.result(), study.out_dir))
    write_whole(study.out_dir / ARCHIVE, runs_archive(study))
    if study.runs:
        write_whole(study.out_dir / TABLE, runs_csv(study))
        found = outcomes(study)
        if found.comparisons:
            write_whole(study.out_dir / LATEX, comparisons_tex(found))
    write_whole(study.out_dir / REPORT, markdown.render(made))
    return study.out_dir / REPORT
