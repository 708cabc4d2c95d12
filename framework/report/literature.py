"""Recipes of the literature next to published figures.

A recipe is a run with `method=NAME` on its command line, or `method=NAME_sweep`, which replaces a
depth network by the plane sweep. Published figures are means over a data set, measured on a GPU.
They appear only next to scenes of that data set, and no difference to them is tested.
"""

from collections import defaultdict
from collections.abc import Mapping, Sequence

from framework.metrics.values import AVERAGE
from framework.registry import SWEPT
from framework.report.statistics.numbers import ABSENT, average, format_mean
from framework.report.study.methods import recipe_of
from framework.report.study.published import Published, literature
from framework.report.study.study import ReportRun, Study
from framework.report.tables import Row, without

FEWEST = 2  # recipes in a table
LLFF, DTU = "LLFF", "DTU"
DATA_SETS = {"llff": LLFF, "dtu": DTU}  # by loader
OF_SCENE = "By others on this scene"
AVGE_THERE, AVGE_HERE = "AVGE by others on this scene", "AVGE here"


def data_set(study: Study, scene: str) -> str:
    """The data set of a scene whose photos are divided as in papers; "" for another scene."""
    loaders = {str(run.record.config["scene"]["name"]) for run in study.of(scene)}
    words = {w for run in study.of(scene) for w in run.record.overrides}
    named = [s for key, s in DATA_SETS.items() if key in loaders or f"scene={key}" in words]
    return named[0] if named and study.split_as_published(scene) else ""


def recipes(study: Study) -> list[tuple[str, list[Row]]]:
    """Return the recipes by scene, for scenes with published figures and at least two recipes."""
    entries = [entry for entry in literature() if entry.data_sets]
    published = {entry.recipe for entry in entries if entry.recipe}
    tables = []
    for scene in study.tested:
        on = data_set(study, scene)
        runs: dict[str, list[ReportRun]] = defaultdict(list)
        for run in study.of(scene):
            name = recipe_of(run.record.overrides).removesuffix(SWEPT)
            if name in published:
                runs[name].append(run)
        if not on or len(set(runs) - {"baseline"}) < FEWEST:
            continue
        shown = [entry for entry in entries if entry.recipe in runs or not entry.recipe]
        others = scene_rows({study.name_of(scene)})
        rows = [_row(entry, runs.get(entry.recipe, []), others, on) for entry in shown]
        rare = (OF_SCENE, AVGE_THERE, AVGE_HERE)
        empty = [name for name in rare if all(row[name] == ABSENT for row in rows)]
        tables.append((scene, without(rows, *empty)))
    return tables


def recipe_sources() -> str:
    """The sources of the figures of recipes."""
    return "; ".join(f"{entry.title}: {entry.note}" for entry in literature() if entry.note)


def _row(
    entry: Published,
    runs: Sequence[ReportRun],
    of_scene: Sequence[Mapping[str, str]],
    on: str,
) -> Row:
    others = [row for row in of_scene if row["method"] == entry.title]
    figures = entry.data_sets.get(on, {})
    repeated = figures.get("repeated", ABSENT)
    if "sd" in figures:
        repeated += f" ± {float(figures['sd']):.2f} ({figures['runs']} runs)"
    elif "repeated" in figures and "runs" in figures:
        repeated += f" ({figures['runs']} run)"
    if "also" in figures:
        repeated += f", {figures['also']}"
    seconds = average([run.record.train_cpu_s for run in runs])
    gaussians = average([float(run.record.gaussians) for run in runs])
    names = sorted({recipe_of(run.record.overrides) for run in runs})
    return {
        "Recipe": ", ".join(names) or "published only",
        "Method": entry.title,
        f"Published, {on}": figures.get("published", ABSENT),
        f"Repeated by others, {on}": repeated,
        OF_SCENE: _joined(others, "psnr"),
        "Here": format_mean([run.mean("psnr") for run in runs], 2),
        AVGE_THERE: _joined(others, "avge"),
        AVGE_HERE: format_mean([run.mean(AVERAGE) for run in runs], 4),
        "Runs": str(len(runs)) if runs else ABSENT,
        "CPU s": f"{seconds:.0f}" if seconds is not None else ABSENT,
        "Gaussians": f"{gaussians:,.0f}" if gaussians is not None else ABSENT,
    }


def _joined(rows: Sequence[Mapping[str, str]], key: str) -> str:
    return ", ".join(row[key] for row in rows if row.get(key)) or ABSENT


def scene_rows(names: set[str]) -> list[dict[str, str]]:
    """Published figures of scenes with these names, by scene."""
    rows = [{"method": entry.title, **row} for entry in literature() for row in entry.scenes]
    result = [r for r in rows if r["scene"] in names or r["scene"].removeprefix("llff_") in names]
    return sorted(result, key=lambda row: row["scene"])
