"""Recipes of the literature beside what their papers and others' repeats got (`literature.csv`).

A recipe is a run with `method=NAME` on its command line, or `method=NAME_sweep`, which takes the
plane sweep in place of a network. What was published is a mean of a data set with 3 views, on a
GPU: of DTU's 15 scenes at a quarter of the size beside scenes of DTU, of LLFF's eight at an eighth
beside all others; what others got on one scene is in `published_scenes.csv`. Neither is the same
experiment as ours, so no difference to it is tested. What may be compared is the order: the pairs
that stand here in the other one are listed.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence

from framework.metrics.values import AVERAGE
from framework.registry import SWEPT
from framework.report.parts.document import Block, Heading, Text, table
from framework.report.statistics.compare import compare
from framework.report.statistics.numbers import ABSENT, average, mean_text, signed
from framework.report.statistics.outcomes import by_pair
from framework.report.study.labels import outside
from framework.report.study.recipes import recipe_of
from framework.report.study.runs import ReportRun, Study
from framework.report.text.published import read, scene_rows

FEWEST = 2  # recipes, to stand side by side
PUBLISHED, REPEATED = "Published, {set}", "Repeated by others, {set}"
LLFF, DTU = "LLFF", "DTU"
OF_SCENE = "By others on this scene"
HERE = "Here"
AVGE_THERE, AVGE_HERE = "AVGE by others on this scene", "AVGE here"
RARE = OF_SCENE, AVGE_THERE, AVGE_HERE  # left out where no recipe has any
REVERSED, OVER = "Published above", "but below here (dB as published, dB here)"
WORDS = ("Recipe", "Method")
PAIRS = (
    "Pairs in the other order than published; here over the seeds that both have. `shown`: the 95 %"
    " interval of this pair alone, paired by seed, excludes zero."
)
AVGES = (
    "AVGE: the geometric mean of the squared error, of the root of 1 - SSIM and of LPIPS; lower is"
    " better. Here LPIPS is fed [-1, 1]; papers often feed [0, 1], which makes AVGE lower."
)
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
    for scene in filter(study.split_as_published, study.tested):
        found: dict[str, list[ReportRun]] = defaultdict(list)
        for run in study.of(scene):
            name = recipe(run)
            if name.removesuffix(SWEPT) in known:
                found[name.removesuffix(SWEPT)].append(run)
        if len(set(found) - {"baseline"}) < FEWEST:
            continue
        on = DTU if _of_dtu(study, scene) else LLFF
        shown = [row for row in rows if row["recipe"] in found or not row["recipe"]]
        there = scene_rows({study.name_of(scene)})
        cells = [_row(row, found.get(row["recipe"], []), there, on) for row in shown]
        empty = {name for name in RARE if all(cell[name] == ABSENT for cell in cells)}
        cells = [{k: cell[k] for k in cell if k not in empty} for cell in cells]
        blocks += [Heading(3, outside(scene)), table(cells, WORDS)]
        blocks += [] if {AVGE_THERE, AVGE_HERE} <= empty else [Text(AVGES)]
        reversals = _reversed(shown, found, on)
        if reversals:
            blocks += [table(reversals, (REVERSED, OVER)), Text(PAIRS)]
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


def _reversed(
    rows: Sequence[Mapping[str, str]], found: Mapping[str, list[ReportRun]], data_set: str
) -> list[dict[str, str]]:
    """For every recipe those that are above it here and below it as published."""
    column = "dtu" if data_set == DTU else "published"
    measured = {recipe: by_pair(runs) for recipe, runs in found.items()}
    # of a recipe that was run in several ways nobody can say which one was published
    once = {recipe for recipe, runs in found.items() if len(measured[recipe]) == len(runs)}
    known = [row for row in rows if row[column] and row["recipe"] in once]
    told = []
    for row in known:
        own, psnr = float(row[column]), measured[row["recipe"]]
        pairs = []
        for other in known:
            if own <= float(other[column]):
                continue
            c = compare(row["method"], psnr, other["method"], measured[other["recipe"]])
            if c is None or c.difference >= 0:
                continue
            here = signed(c.difference)
            here = f"{here} shown" if c.significant else here
            pairs.append(f"{other['method']} ({signed(own - float(other[column]))}, {here})")
        if pairs:
            told.append({REVERSED: row["method"], OVER: "; ".join(pairs)})
    return told


def _row(
    row: Mapping[str, str],
    runs: Sequence[ReportRun],
    of_scene: Sequence[Mapping[str, str]],
    data_set: str,
) -> dict[str, str]:
    others = [there for there in of_scene if there["method"] == row["method"]]
    printed, repeated = row["published"], row["repeated"] or ABSENT
    if data_set == DTU:
        printed, repeated = row["dtu"] or ABSENT, row["dtu_repeated"] or ABSENT
    elif row["sd"]:
        repeated += f" ± {float(row['sd']):.2f} ({row['runs']} runs)"
    elif row["repeated"] and row["runs"]:
        repeated += f" ({row['runs']} run)"
    if data_set == LLFF and row["also"]:
        repeated += f", {row['also']}"
    seconds = average([run.record.train_cpu_s for run in runs])
    gaussians = average([float(run.record.gaussians) for run in runs])
    return {
        "Recipe": ", ".join(sorted({recipe(run) for run in runs})) or "published only",
        "Method": row["method"],
        PUBLISHED.format(set=data_set): printed,
        REPEATED.format(set=data_set): repeated,
        OF_SCENE: ", ".join(there["psnr"] for there in others if there["psnr"]) or ABSENT,
        HERE: mean_text([run.mean("psnr") for run in runs], 2) if runs else ABSENT,
        AVGE_THERE: ", ".join(there["avge"] for there in others if there["avge"]) or ABSENT,
        AVGE_HERE: mean_text([run.mean(AVERAGE) for run in runs], 4) if runs else ABSENT,
        "Runs": str(len(runs)) if runs else ABSENT,
        "CPU s": f"{seconds:.0f}" if seconds is not None else ABSENT,
        "Gaussians": f"{gaussians:,.0f}" if gaussians is not None else ABSENT,
    }
