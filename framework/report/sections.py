"""The report as a document: the verdict with the figure that shows it, pictures, speed against
accuracy, what the methods did, and then the tables, for who wants to check."""

from __future__ import annotations

from collections.abc import Sequence

from framework.records.search import Searched
from framework.report import details, opening
from framework.report.figures import curves, stress
from framework.report.figures.closeup import draw_closeup
from framework.report.figures.files import chart_picture
from framework.report.figures.images import draw_images, draw_sigma_maps
from framework.report.parts.document import Block, Document, Heading, Picture, Text, table
from framework.report.statistics.outcomes import Outcomes, outcomes
from framework.report.study.beside import OPEN
from framework.report.study.labels import outside
from framework.report.study.runs import Study
from framework.report.text import capacities, gaps, searched, tables
from framework.report.text.dose import dose
from framework.report.text.drawn import over_draws
from framework.report.text.literature import literature
from framework.report.text.provenance import provenance_blocks
from framework.report.text.published import published

BEST_BUDGETS = "Of each method, the budget with the highest mean PSNR on the scene."
HIDDEN = "No pictures of {scenes}: this report was built without photos, to be passed on."


def document(study: Study, title: str, visible: Sequence[str]) -> Document:
    """Everything the report says; draws its figures into `study.out_dir`, with pictures of the
    `visible` scenes."""
    if study.searched is not None:
        return _of_search(study, study.searched, title)
    found, panels = outcomes(study), stress.panels(study)
    between = [] if panels else capacities.contests(study)
    shown = stress.shown_scenes(study, panels)
    seen = [scene for scene in shown if scene in visible]
    blocks: list[Block] = [Heading(1, outside(title))]
    if panels:
        blocks += opening.along_stress(study, panels, found)
    elif study.has_budgets:
        blocks += opening.over_budgets(study, found, between)
    else:
        blocks += opening.plain(study, found)
    blocks += _pictures(study, found, seen, visible)
    blocks += details.costs(study, [] if panels else study.tested)
    blocks += dose(study)
    if not panels:  # the strengths of a stress share their seeds: no independent pairs
        blocks += details.main_table(study)
        blocks += [*details.compared(found), *details.between_capacities(between)]
        blocks += [*details.stability(found), *over_draws(study), *opening.stress_beside(study)]
    blocks += [*gaps.failures(study), *gaps.missing_runs(study)]
    blocks += [*details.worst(study), *details.by_tag(study, shown), *_courses(study, shown, seen)]
    if study.tested:
        blocks += [*literature(study), *published(study)]
    if study.runs:
        blocks += [Heading(2, "Every run"), table(tables.seed_rows(study), details.WORDS)]
        blocks += [Text(OPEN)] if study.linked else []
    blocks += [*gaps.missing_metrics(study), *provenance_blocks(study)]
    scenes, families, methods = map(tuple, (study.scenes, study.families, study.methods))
    return Document(outside(title), tuple(blocks), scenes, families, methods)


def _of_search(study: Study, trials: Searched, title: str) -> Document:
    """That of a search, whose runs were made to choose and not to compare."""
    blocks: list[Block] = [Heading(1, outside(title)), *searched.opening(trials)]
    blocks += [*gaps.gap_notes(study, pooled=False), *searched.trials(trials)]
    blocks += [*gaps.failures(study), *provenance_blocks(study)]
    scenes, families, methods = map(tuple, (study.scenes, study.families, study.methods))
    return Document(outside(title), tuple(blocks), scenes, families, methods)


def _pictures(
    study: Study, found: Outcomes, seen: Sequence[str], visible: Sequence[str]
) -> list[Block]:
    """Close-ups of what the verdict is about, then all methods on all chosen views."""
    if study.archived:
        return []
    hidden = [scene for scene in study.scenes if scene not in visible]
    blocks: list[Block] = []
    if hidden:
        blocks = [Heading(2, "Pictures left out"), Text(HIDDEN.format(scenes=study.listed(hidden)))]
    told = shown_pair(study, found)
    close = [(scene, draw_closeup(study, scene, told)) for scene in seen]
    return [
        *blocks,
        *_section(study, "Pictures", close),
        *_section(study, "Images", [(scene, draw_images(study, scene)) for scene in seen]),
    ]


def shown_pair(study: Study, found: Outcomes) -> tuple[str, ...]:
    """The best method and its baseline, without their budgets; where that is best itself, it and
    the highest other."""
    if not study.runs:
        return ()
    best = study.family_of[found.best]
    base = study.family_of[study.baseline_of(found.best)]
    others = [m for m in found.psnr if study.family_of[m] != best]
    if best != base or not others:
        return tuple(dict.fromkeys((best, base)))
    return best, study.family_of[max(others, key=lambda method: found.psnr[method].mean)]


def _courses(study: Study, shown: Sequence[str], seen: Sequence[str]) -> list[Block]:
    """Where runs disagree, and quality over training time."""
    maps = [(scene, draw_sigma_maps(study, scene)) for scene in seen if not study.archived]
    return [
        *_section(study, "Where runs disagree", maps),
        *_section(study, "Quality over training time", [(s, _curves(study, s)) for s in shown]),
    ]


def _section(
    study: Study, heading: str, pictures: Sequence[tuple[str, Picture | None]]
) -> list[Block]:
    present = [(scene, picture) for scene, picture in pictures if picture is not None]
    if not present:
        return []
    of_many = study.has_budgets
    blocks: list[Block] = [Heading(2, heading), *([Text(BEST_BUDGETS)] if of_many else [])]
    return blocks + [block for s, picture in present for block in (Heading(3, s), picture)]


def _curves(study: Study, scene: str) -> Picture | None:
    chart = curves.chart(study, scene)
    if chart is None:
        return None
    alt = f"Quality over training time of {scene}"
    return chart_picture(study.out_dir, (chart,), alt, curves.caption(study, scene))
