"""Recipes of the literature beside what their papers and others' repeats got (`literature.csv`).

A recipe is a run with `method=NAME` on its command line, or `method=NAME_sweep`, which takes the
plane sweep in place of a network. What was published is a mean of a data set with 3 views, on a
GPU: of DTU's 15 scenes at a quarter of the size beside scenes of DTU, of LLFF's eight at an eighth
beside all others; a third party's runs of one scene are in `published_scenes.csv`. Neither is the
same experiment as ours, so no difference is tested.
"""

from __future__ import annotations

from collections import defaultdict

from framework.registry import SWEPT
from framework.report.parts.document import Block, Heading, Text, table
from framework.report.statistics.numbers import ABSENT, average, mean_text
from framework.report.study.labels import outside
from framework.report.study.recipes import recipe_of
from framework.report.study.runs import ReportRun, Study
from framework.report.text.published import read, scene_rows

FEWEST = 2  # recipes, to stand side by side
PUBLISHED, REPEATED = "Published, {set}", "Repeated by others, {set}"
LLFF, DTU = "LLFF", "DTU"
OF_SCENE = "A repeat of this scene"
HERE = "Here"
WORDS = ("Recipe", "Method")
WHAT = (
    "PSNR in dB of recipes (`method=NAME`; one whose name ends in `_sweep` takes the plane sweep"
    " where the paper has a network) as published and as repeated by others (± σ over so many"
    " runs), means over LLFF's scenes at 1/8 of the size, or over DTU's at 1/4, with 3 views,"
    " beside the runs of this study. Here parts are left out, which `conf/method/NAME.yaml` names,"
    " and steps, size and scenes may differ, so the order may be compared and the numbers may not."
    " {sources}"
)


def literature(study: Study) -> list[Block]:
    """The recipes of a study; nothing where there are fewer than two."""
    rows = read("literature.csv")
    known = {row["recipe"]: row for row in rows if row["recipe"]}
    blocks: list[Block] = []
    for scene in study.tested:
        found: dict[str, list[ReportRun]] = defaultdict(list)
        for run in study.of(scene):
            name = recipe(run)
            if name.removesuffix(SWEPT) in known:
                found[name.removesuffix(SWEPT)].append(run)
        if len(set(found) - {"baseline"}) < FEWEST:
            continue
        repeats = {row["method"]: row["psnr"] for row in scene_rows({study.name_of(scene)})}
        on = DTU if _of_dtu(study, scene) else LLFF
        cells = [
            _row(row, found.get(row["recipe"], []), repeats.get(row["method"], ABSENT), on)
            for row in rows
            if row["recipe"] in found or not row["recipe"]
        ]
        blocks += [Heading(3, outside(scene)), table(cells, WORDS)]
    if not blocks:
        return []
    told = "; ".join(f"{row['method']}: {row['note']}" for row in rows)
    return [Heading(2, "Beside the literature"), Text(WHAT.format(sources=told)), *blocks]


def recipe(run: ReportRun) -> str:
    """The name behind `method=` on the run's command line, "" without one."""
    return recipe_of(run.record.overrides)


def _of_dtu(study: Study, scene: str) -> bool:
    return any(
        run.record.config["scene"]["name"] == "dtu" or "scene=dtu" in run.record.overrides
        for run in study.of(scene)
    )


def _row(
    row: dict[str, str], runs: list[ReportRun], of_scene: str, data_set: str
) -> dict[str, str]:
    printed, repeated = row["published"], row["repeated"] or ABSENT
    if data_set == DTU:
        printed, repeated = row["dtu"] or ABSENT, row["dtu_repeated"] or ABSENT
    elif row["sd"]:
        repeated += f" ± {float(row['sd']):.2f} ({row['runs']} runs)"
    elif row["repeated"]:
        repeated += f" ({row['runs']} run)"
    seconds = average([run.record.train_cpu_s for run in runs])
    gaussians = average([float(run.record.gaussians) for run in runs])
    return {
        "Recipe": ", ".join(sorted({recipe(run) for run in runs})) or "published only",
        "Method": row["method"],
        PUBLISHED.format(set=data_set): printed,
        REPEATED.format(set=data_set): repeated,
        OF_SCENE: of_scene,
        HERE: mean_text([run.mean("psnr") for run in runs], 2) if runs else ABSENT,
        "Runs": str(len(runs)) if runs else ABSENT,
        "CPU s": f"{seconds:.0f}" if seconds is not None else ABSENT,
        "Gaussians": f"{gaussians:,.0f}" if gaussians is not None else ABSENT,
    }
