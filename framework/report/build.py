"""From the folders of one or more studies to a report: load, compare, find, render."""

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from framework.errors import require
from framework.files.whole import make_folder, write_whole
from framework.records.archive import ARCHIVE, has_archive, read_archive
from framework.report import literature, stress, tables
from framework.report.export import TABLE, results_files, runs_archive, runs_csv
from framework.report.figures.chart import Picture, chart_picture
from framework.report.figures.charts import cost_charts, curves, has_members, stress_charts
from framework.report.figures.forest import forest_of, forest_picture
from framework.report.figures.pictures import draw_closeup, remove_pictures
from framework.report.figures.views import own_scenes
from framework.report.findings import Findings, find, largest_effect
from framework.report.gallery import gallery
from framework.report.provenance import provenance
from framework.report.render import Page, publish, say
from framework.report.study import notes
from framework.report.study.collect import collect, run_dirs
from framework.report.study.methods import learned_footnote
from framework.report.study.published import bibtex
from framework.report.study.study import Study
from framework.report.study.words import outside

REPORT = "report.md"
MOST_NAMED = 8  # differences that are not significant, in the verdict


@dataclass(frozen=True)
class Report:
    """A report that was written.

    Attributes:
        path: of `report.md`.
        verdict: as plain text.
    """

    path: Path
    study: Study
    verdict: str


def build_report(
    study_dirs: Path | Sequence[Path],
    title: str | None = None,
    out_dir: Path | None = None,
    photos: bool = True,
    rival: str = "",
) -> Report:
    """Write the report of all runs below the folders.

    A run whose record or tables are damaged counts as failed. Pictures of an earlier report are
    removed.

    Args:
        study_dirs: folders with runs or with an archive of runs.
        title: the heading; by default the name of the report's folder.
        out_dir: folder of the report; by default the first study.
        photos: show all scenes and link to the runs. If False, the report shows only the embedded
            scene and has no links, so that it can be published without the photos.
        rival: display or registry name of the baseline; "" for training without a method.

    Raises:
        UserError: There is no run, or none of the baseline. A picture of a run is damaged. An
            earlier report or an archive has what this one would lose.
    """
    study = collect(study_dirs, out_dir, rival)
    require(
        out_dir is not None
        or study.out_dir not in study.archived
        or not (study.out_dir / REPORT).exists(),
        f"{study.out_dir}: expected runs, got only {ARCHIVE} next to an earlier report, which may"
        " show pictures of the runs; add --out DIR to write another report",
    )
    _keep_other_archive(study)
    return _build(replace(study, linked=study.linked and photos), title, photos)


def _keep_other_archive(study: Study) -> None:
    """Raise UserError if the report would overwrite an archive with runs that are nowhere else."""
    entries = read_archive(study.out_dir) if has_archive(study.out_dir) else []
    present = {folder.name for folder in run_dirs(study.out_dir)}
    present |= {run.run.run_dir.name for run in study.runs}
    present |= {run.run.run_dir.name for run in study.failed}
    lost = sorted({entry.run.run_dir.name for entry in entries} - present)
    require(
        not lost,
        f"{study.out_dir / ARCHIVE}: expected runs of this report, got {len(lost)} others (as"
        f" {lost[0] if lost else ''}), whose folders are gone; write the report to another --out"
        " DIR, or delete that file",
    )


def _build(study: Study, title: str | None, photos: bool) -> Report:
    """The report of a study."""
    make_folder(study.out_dir)
    visible = study.scenes if photos else own_scenes(study)
    if study.archived:  # the pictures went with the runs' folders
        visible = []
    if not photos:
        remove_pictures(study, visible)
    findings = find(study)
    with ThreadPoolExecutor(1) as executor:  # photos are encoded while charts are drawn
        shots = executor.submit(gallery, study, visible)
        context = _context(findings, visible)
        data = {**shots.result(), "beside": False}
    heading = outside(title or study.out_dir.resolve().name)
    page = Page(heading, study.out_dir, study.families, study.scenes, data)
    files = {ARCHIVE: runs_archive(study)}
    if study.runs:
        files[TABLE] = runs_csv(study)
        files |= results_files(context["results"]) if context["results"] else {}
    publish("report.jinja", study.out_dir / REPORT, page, context)
    for name, content in files.items():
        write_whole(study.out_dir / name, content)
    macro = "stress_verdict" if findings.panels else "verdict"
    verdict = say(macro, **context) if study.searched is None else ""
    return Report(study.out_dir / REPORT, study, verdict)


def _context(findings: Findings, visible: Sequence[str]) -> dict[str, Any]:
    """What the templates need; draws the figures."""
    study = findings.study
    context: dict[str, Any] = {
        "findings": findings,
        "tables": tables,
        "notes": notes,
        "learned_footnote": learned_footnote,
        "largest_effect": largest_effect,
        "capacity_text": tables.capacity_text,
        "heading_of": tables.heading_of,
        "MOST_NAMED": MOST_NAMED,
        "literature": literature,
        "provenance": provenance(study),
        "bibtex": bibtex(findings.papers) if study.runs else "",
    }
    if study.searched is not None:
        return context | {"metric": tables.NAMES[study.searched.metric], "results": {}}
    return context | _figures(findings, visible)


def _figures(findings: Findings, visible: Sequence[str]) -> dict[str, Any]:
    """All figures, by where the template shows them."""
    study = findings.study
    shown = stress.shown_scenes(study, findings.panels) if findings.panels else study.scenes
    seen = [scene for scene in shown if scene in visible]
    hidden = [scene for scene in study.scenes if scene not in visible]
    results = {} if findings.panels or not study.tested else tables.results(study)
    missing: dict[tuple[str, Any], list[int]] = {}
    for scene, method, seed in study.missing:
        missing.setdefault((scene, method), []).append(seed)
    return {
        "results": results,
        "shown": shown,
        "hidden": [] if study.archived else hidden,
        "missing": missing,
        "forest": _forest(findings),
        "stress_pictures": _stress_pictures(findings),
        "closeups": _drawn(lambda scene: draw_closeup(study, scene), seen),
        "costs": [] if findings.panels else [_cost(study, scene) for scene in study.tested],
        "machines": sorted({outside(str(r.record.provenance.get("cpu"))) for r in study.runs}),
        "has_members": lambda scene: has_members(study, scene),
        "curves": _drawn(lambda scene: curves(study, scene), shown),
    }


def _drawn(
    draw: Callable[[str], Picture | None], scenes: Iterable[str]
) -> list[tuple[str, Picture]]:
    pictures = [(scene, draw(scene)) for scene in scenes]
    return [(scene, picture) for scene, picture in pictures if picture is not None]


def _forest(findings: Findings) -> Picture | None:
    study = findings.study
    if findings.panels or not findings.outcomes.comparisons:
        return None
    plot = forest_of(study, findings.outcomes)
    alt = f"Differences of PSNR to {plot.against} with their intervals"
    return forest_picture(study.out_dir, plot, alt)


def _cost(study: Study, scene: str) -> tuple[str, list[Picture]]:
    """A scene with the charts of its costs."""
    pictures = []
    for charts in cost_charts(study, scene):
        costs = " and ".join(chart.x_label for chart in charts)
        pictures.append(chart_picture(study.out_dir, charts, f"PSNR against {costs} on {scene}"))
    return scene, pictures


def _stress_pictures(findings: Findings) -> dict[str, Picture]:
    study, pictures = findings.study, {}
    for panel in findings.panels:
        charts = stress_charts(study, panel, findings.limits, findings.against)
        alt = f"PSNR of {panel.title} against {panel.axis.label}"
        pictures[panel.file] = chart_picture(study.out_dir, charts, alt)
    return pictures
