"""A report as one Markdown page. The first screen is one table and one sentence; all the rest is
for who wants to check."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import pandas as pd

from framework.metrics import METRICS, Missing
from framework.record import Run
from framework.report.collect import Study
from framework.report.figures import DrawnFigure
from framework.report.finding import sentence
from framework.report.outcomes import Outcomes, outcomes
from framework.report.tables import (
    comparison_table,
    main_table,
    seed_table,
    tag_table,
    tags_of,
)

DEFINITIONS = (
    "PSNR, SSIM and FLIP: mean over the test views, then over seeds, from the saved 8-bit renders."
    " σ_PSNR: standard deviation (n − 1) over seeds of the mean PSNR over the test views{over}, in"
    " brackets its 95 % interval (χ²). Train: wall seconds of the training alone, mean over runs."
)


def render(study: Study, figures: Sequence[DrawnFigure], title: str) -> str:
    """The page's text; figures are referred to by names relative to it."""
    found = outcomes(study)
    blocks = [f"# {title}", sentence(study, found)]
    if study.runs:
        over = " and scenes" if len(study.scenes) > 1 else ""
        blocks += [_table(main_table(study)), DEFINITIONS.format(over=over)]
    blocks += [f"**Note.** {note}" for note in study.notes]
    blocks += _failures(study)
    blocks += _comparisons(found)
    blocks += _by_tag(study)
    blocks += _figures(figures, "images", "Images")
    blocks += _figures(figures, "curves", "Quality over training time")
    if study.runs:
        blocks += ["## Every run", _table(seed_table(study))]
    blocks += _missing(study)
    blocks += _provenance(study)
    return "\n\n".join(blocks) + "\n"


def _failures(study: Study) -> list[str]:
    if not study.failed:
        return []
    frame = pd.DataFrame(
        {
            "Run": run.run_dir.relative_to(study.study_dir).as_posix(),
            "Overrides": _code(" ".join(run.record.overrides)),
            "Error": run.record.error or "not told",
        }
        for run in study.failed
    )
    return ["## Failed runs", _table(frame)]


def _comparisons(found: Outcomes) -> list[str]:
    if not found.comparisons:
        return []
    text = (
        "Differences of runs paired by scene and seed; t interval and two-sided t test. The"
        " interval belongs to its row alone, the last column is corrected for all rows."
    )
    return ["## Comparisons", _table(comparison_table(found)), text]


def _by_tag(study: Study) -> list[str]:
    blocks = []
    for scene in study.scenes:
        tags = tags_of(study, scene)
        if tags:
            blocks += [f"### {scene}", _table(tag_table(study, scene, tags))]
    return ["## Kinds of test views apart", *blocks] if blocks else []


def _figures(figures: Iterable[DrawnFigure], kind: str, heading: str) -> list[str]:
    blocks = []
    for figure in figures:
        if figure.kind == kind:
            first, *others = figure.files
            links = "".join(f" [{name.rpartition('.')[2].upper()}]({name})" for name in others)
            blocks += [
                f"### {figure.scene}",
                f"![{heading} of {figure.scene}]({first})",
                figure.caption + links,
            ]
    return [f"## {heading}", *blocks] if blocks else []


def _missing(study: Study) -> list[str]:
    """Each missing metric once per reason, with the number of runs it concerns."""
    counts: dict[tuple[str, str], int] = {}
    for run in study.runs:
        for metric in METRICS:
            value = run.record.summary.get(metric)
            if isinstance(value, Missing):
                key = (metric.upper(), value.reason)
                counts[key] = counts.get(key, 0) + 1
    lines = [
        f"- {metric}: missing in {n} of {len(study.runs)} runs: {reason}"
        for (metric, reason), n in sorted(counts.items())
    ]
    return ["## Missing metrics", "\n".join(lines)] if lines else []


def _provenance(study: Study) -> list[str]:
    runs = [run.run for run in study.runs] + list(study.failed)
    lines = [f"- {name}: {'; '.join(values)}" for name, values in _facts(runs).items() if values]
    commands = [
        f"- `{run.run_dir.relative_to(study.study_dir).as_posix()}`:"
        f" {_code(' '.join(run.record.overrides)) or 'no overrides'}"
        for run in runs
    ]
    scenes = [
        f"- {label}: protocol {scene.protocol}, fingerprint `{scene.fingerprint}`; trained on"
        f" {', '.join(scene.training)}; tested on {', '.join(scene.test)}"
        for label, scene in {r.scene: r.record.scene for r in study.runs}.items()
        if scene is not None
    ]
    blocks = ["## Provenance", "\n".join(lines)]
    if scenes:
        blocks += ["Scenes:", "\n".join(scenes)]
    return [*blocks, "Overrides on the command line:", "\n".join(commands)]


def _facts(runs: Sequence[Run]) -> dict[str, list[str]]:
    """Each fact of provenance with all the distinct values it has among the runs."""
    sources = [run.record.provenance for run in runs]
    facts = {
        "Code": [_git(p.get("git")) + f", sources `{str(p.get('code'))[:12]}`" for p in sources],
        "fishersplat": [str(p.get("fishersplat")) for p in sources],
        "Python": [str(p.get("python")) for p in sources],
        "Packages": [_packages(p.get("packages") or {}) for p in sources],
        "CPU": [f"{p.get('cpu')}, {p.get('cores')} cores" for p in sources],
        "Threads": [str(p.get("threads")) for p in sources],
        "System": [str(p.get("system")) for p in sources],
    }
    return {name: sorted(set(values)) for name, values in facts.items()}


def _git(state: dict[str, object] | None) -> str:
    if state is None:
        return "no git checkout"
    return f"git `{state['sha']}`{' with local changes' if state['dirty'] else ''}"


def _packages(versions: dict[str, str | None]) -> str:
    return " ".join(f"{name} {number}" for name, number in sorted(versions.items()) if number)


def _code(text: str) -> str:
    return f"`{text.replace('`', '')}`" if text else ""


def _table(frame: pd.DataFrame) -> str:
    escaped = frame.map(lambda cell: str(cell).replace("|", "\\|").replace("\n", " "))
    numeric = ("left" if name in TEXT_COLUMNS else "right" for name in escaped.columns)
    return escaped.to_markdown(index=False, disable_numparse=True, colalign=tuple(numeric))


TEXT_COLUMNS = frozenset(
    {"Scene", "Method", "Compared with", "Run", "Overrides", "Error", "Parameters", "Folder"}
)
