"""`fishersplat leaderboard DIR`: the results of every method over all studies of a folder.

Studies differ in scenes, resolution and budget, so their PSNRs are not ranked against each other.
Instead, every method is compared with the baseline of the same study: significantly better,
significantly worse, or neither, each with the interval of that report.
"""

import os
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from urllib.parse import quote

from framework.errors import Arguments, UserError, require
from framework.files.limits import RUNS
from framework.files.whole import make_folder, write_whole
from framework.records import RUN_FOLDERS
from framework.records.archive import ARCHIVE
from framework.records.provenance import ROOT
from framework.records.run_files import csv_text
from framework.report.figures.chart import Picture
from framework.report.figures.forest import Forest, Row, forest_picture
from framework.report.figures.palette import looks
from framework.report.main import BASELINE_HELP, tell
from framework.report.render import Page, publish, say
from framework.report.statistics.compare import Comparison
from framework.report.statistics.estimates import Interval
from framework.report.statistics.numbers import (
    ABSENT,
    format_difference,
    format_interval,
    format_mean,
    format_p,
)
from framework.report.statistics.outcomes import Outcomes, outcomes, seed_means
from framework.report.stress import panels
from framework.report.study.collect import collect, find_rival, holds_run, walked
from framework.report.study.methods import Method, learned_footnote
from framework.report.study.study import ReportRun, Study
from framework.report.study.words import natural, outside
from framework.report.tables import Link
from framework.report.tables import Row as Cells
from framework.scenes import HELD_OUT

REPORT, TABLE = "leaderboard.md", "leaderboard.csv"
COMMITTED = ROOT / "reports" / "committed"  # the repository's own studies
MOST_ROWS = 80
COLUMNS = ("study", "method", "against", "scenes", "seeds", "difference_db", "low", "high", "p")
RESULTS = {1: "better", 0: "", -1: "worse"}


@dataclass(frozen=True)
class Entry:
    """A study with its outcomes.

    Attributes:
        name: its folder below the one that was given.
    """

    name: str
    study: Study
    outcomes: Outcomes


@dataclass(frozen=True)
class Match:
    """A comparison of a study, with its corrected interval and p."""

    entry: Entry
    comparison: Comparison
    joint: Interval
    p: float

    @property
    def family(self) -> Method:
        return self.comparison.method.family

    @property
    def ranked(self) -> bool:
        """Whether it is with another method, not with another budget of the same one."""
        return self.family != self.comparison.baseline.family

    @property
    def sign(self) -> int:
        """1 if significantly better, -1 if worse, else 0."""
        if not self.comparison.significant:
            return 0
        return 1 if self.comparison.difference > 0 else -1


Leagues = Sequence[tuple[Method, Sequence[Match]]]


def leaderboard(folder: Path, out_dir: Path, rival: str = "") -> tuple[Path, int, str]:
    """Write the leaderboard of all studies below the folder; returns its path, how many are in it,
    and the verdict. rival: the baseline of the studies that have it.

    Raises:
        UserError: there is no study, or none with the rival. One that cannot be read is listed.
    """
    entries, broken = _entries(folder, out_dir, rival)
    require(
        bool(entries or broken),
        f"{folder}: expected studies with runs, or with a {ARCHIVE}, below this folder, got none;"
        " give the folder that holds them, as reports",
    )
    matches = [match for entry in entries for match in _matches(entry)]
    make_folder(out_dir)
    ranked = [match for match in matches if match.ranked]
    leagues = _by_league(ranked)
    families = sorted({match.family for match in matches}, key=lambda method: method.order)
    context: dict[str, Any] = {
        "matches": ranked,
        "better": _counts(leagues, 1),
        "worse": _counts(leagues, -1),
        "ranks": _ranks(leagues),
        "forest": _forest(ranked, families, out_dir),
        "studies": [_study_row(entry, out_dir) for entry in entries],
        "broken": [{"Study": name, "Why": why} for name, why in sorted(broken.items())],
        "rows": [_row(match) for match in matches],
        "footnote": learned_footnote(m for entry in entries for m in entry.study.methods),
    }
    page = Page("Leaderboard", out_dir, families, (), {})
    publish("leaderboard.jinja", out_dir / REPORT, page, context)
    write_whole(out_dir / TABLE, _csv(matches))
    return out_dir / REPORT, len(entries), say("leaderboard_verdict", **context)


def _entries(folder: Path, out_dir: Path, rival: str) -> tuple[list[Entry], dict[str, str]]:
    """The studies with their outcomes; and by name why others are left out.

    Raises:
        UserError: no study has a method that is called like the rival.
    """
    entries: list[Entry] = []
    broken: dict[str, str] = {}
    runs: list[ReportRun] = []
    for path in _study_dirs(folder):
        name = outside(os.path.relpath(path, folder)) if path != folder else outside(path.name)
        try:
            study = collect(path, out_dir)
            runs += study.runs
            study = replace(study, rival=find_rival(rival, study.runs))
        except UserError as error:
            broken[name] = outside(str(error))
            continue
        why = _left_out(study)
        if why:
            broken[name] = why
        else:
            entries.append(Entry(name, study, outcomes(study)))
    if runs:
        find_rival(rival, runs)  # raises if no study has it
    return sorted(entries, key=lambda entry: natural(entry.name)), broken


def _left_out(study: Study) -> str:
    """Why a study compares no methods; "" if it does."""
    if not study.runs:
        return "no run of it finished"
    if study.searched is not None:
        return "the trials of a search, which were made to choose options"
    if panels(study):
        return "a stress study, whose differences depend on the strength; see its report"
    held = sorted({run.protocol for run in study.runs if run.protocol.endswith(HELD_OUT)})
    return f"evaluated on training photos (scene.split={outside(held[0])})" if held else ""


def _study_dirs(folder: Path) -> list[Path]:
    """The studies in the folder and below it, sorted; the repository's own only if the folder is
    theirs."""
    folders = {folder} if (folder / RUN_FOLDERS).is_dir() else set()
    committed = COMMITTED.resolve()
    within = folder.resolve().is_relative_to(committed)
    for place, names in walked(folder):
        inside = place.relative_to(folder).parts
        if not within and place.resolve().is_relative_to(committed):
            continue
        if inside and holds_run(names):
            cut = inside.index(RUN_FOLDERS) if RUN_FOLDERS in inside[:-1] else len(inside) - 1
            folders.add(folder.joinpath(*inside[:cut]))
        elif ARCHIVE in names and RUN_FOLDERS not in inside:
            folders.add(place)
    require(len(folders) <= RUNS, f"{folder}: expected at most {RUNS:,} studies, got more")
    return sorted(folders)


def _matches(entry: Entry) -> list[Match]:
    comparisons = entry.outcomes.comparisons.values()
    return [Match(entry, c, c.joint, c.p_joint or 0.0) for c in comparisons if c.joint is not None]


def _n_scenes(study: Study, scenes: Sequence[str]) -> str:
    """How many scenes; conditions of one count once."""
    return str(len({study.name_of(scene) for scene in scenes}))


def _by_league(matches: Sequence[Match]) -> list[tuple[Method, list[Match]]]:
    """The families in the order of reports, each with its comparisons. Those with learned weights
    are never pooled with runs without them."""
    groups: dict[tuple[Method, str], list[Match]] = defaultdict(list)
    for match in sorted(matches, key=lambda match: (match.family.order, match.family.learned)):
        groups[match.family, match.family.learned].append(match)
    return [(family, of_league) for (family, _), of_league in groups.items()]


def _counts(leagues: Leagues, sign: int) -> list[tuple[Method, int]]:
    """The families with comparisons of this sign, the most frequent first."""
    counts = [(family, [m.sign for m in matches].count(sign)) for family, matches in leagues]
    return sorted([pair for pair in counts if pair[1]], key=lambda pair: -pair[1])


def _ranks(leagues: Leagues) -> list[Cells]:
    """One row per method, sorted by wins minus losses, then by the mean difference."""
    rows = []
    names = [family.name for family, _ in leagues]
    for family, matches in leagues:
        recipe = family.recipe and names.count(family.name) > 1
        signs = [match.sign for match in matches]
        differences = [match.comparison.difference for match in matches]
        mean = sum(differences) / len(matches)
        ends = [format_difference(end) for end in (min(differences), max(differences))]
        row: Cells = {
            "Method": f"{family} (recipe)" if recipe else family,
            "Studies": str(len({match.entry.name for match in matches})),
            "Comparisons": str(len(matches)),
            "Better": str(signs.count(1)),
            "Not significant": str(signs.count(0)),
            "Worse": str(signs.count(-1)),
            "Mean difference (dB)": format_difference(mean),
            "Lowest to highest (dB)": " to ".join(ends),
        }
        rows.append((-sum(signs), -mean, row))
    return [row for *_, row in sorted(rows, key=lambda entry: entry[:2])]


def _study_row(entry: Entry, out_dir: Path) -> Cells:
    study, outcomes = entry.study, entry.outcomes
    best = _advised(study, outcomes)
    runs = study.of(method=best)
    values = list(seed_means(runs, study.tested).values())
    return {
        "Study": _link(entry, out_dir),
        "Use": best if _matches(entry) else "no advice",
        "Scenes": _n_scenes(study, study.scenes),
        "Seeds": str(len(values)),
        "Methods": str(len(study.methods)),
        "PSNR (dB)": format_mean(values, 2, show_half=True) if values else ABSENT,
        "Gaussians": format_mean([float(run.record.gaussians) for run in runs], 0),
        "Train, CPU (s)": format_mean([run.record.train_cpu_s for run in runs], 1),
    }


def _advised(study: Study, outcomes: Outcomes) -> Method:
    """The verdict's method; of the baseline with several budgets, the best one."""
    best = outcomes.best
    if best != study.baseline_of(best) or not study.has_budgets:
        return best
    budgets = [m for m in outcomes.psnr if m.family == study.families[0]]
    return max(budgets, key=lambda m: (outcomes.psnr[m].mean, m.label), default=best)


def _link(entry: Entry, out_dir: Path) -> str | Link:
    """To the report of a study, if it has one."""
    report = entry.study.runs[0].run.run_dir.parent.parent / "report.md"
    if not report.is_file():
        return entry.name
    way = Path(os.path.relpath(report.resolve(), out_dir.resolve())).as_posix()
    return Link(entry.name, quote(os.fsencode(way)))


def _forest(matches: Sequence[Match], families: Sequence[Method], out_dir: Path) -> Picture | None:
    """One row per method and study; only the significant ones if there are very many."""
    shown = sorted(matches, key=lambda m: (m.family.order, natural(m.entry.name)))
    if len(shown) > MOST_ROWS:
        shown = [match for match in shown if match.sign][:MOST_ROWS]
    if not shown:
        return None
    numbers = looks(match.family.label for match in shown)
    rows = []
    for match in shown:
        c, family = match.comparison, match.family
        label = ", ".join([match.entry.name, *(f"{key}={v}" for key, v in c.method.budget)])
        how = numbers[family.label], c.difference, match.joint, True, c.significant
        rows.append(Row(family.name, label, *how, families.index(family)))
    x_label = "PSNR above the baseline of the study (dB)"
    plot = Forest("leaderboard", "the baseline of the study", x_label, tuple(rows))
    alt = "Differences to the baseline by method and study"
    return forest_picture(out_dir, plot, alt)


def _row(match: Match) -> Cells:
    c = match.comparison
    return {
        "Study": match.entry.name,
        "Method": c.method,
        "Compared with": c.baseline,
        "Scenes": _n_scenes(match.entry.study, c.scenes),
        "Seeds": str(c.n),
        "ΔPSNR (dB)": format_difference(c.difference),
        "95 %, corrected": format_interval(match.joint),
        "p": format_p(match.p),
        "Result": RESULTS[match.sign],
    }


def _csv(matches: Sequence[Match]) -> str:
    """Every comparison in full digits."""
    rows = []
    for match in matches:
        c, scenes = match.comparison, _n_scenes(match.entry.study, match.comparison.scenes)
        labels = (match.entry.name, c.method.label, c.baseline.label, scenes, c.n)
        values = (*labels, c.difference, match.joint.low, match.joint.high, match.p)
        rows.append(dict(zip(COLUMNS, values, strict=True)))
    return csv_text(rows, COLUMNS)


def main(arguments: list[str], prog: str) -> int:
    """The subcommand; exit status 0.

    Raises:
        UserError: for bad input, and if the leaderboard, which is written all the same, has no
            study.
    """
    text = "What all studies of a folder say about every method, from their runs or archives."
    parser = Arguments(prog=prog, description=text)
    parser.add_argument("folder", type=Path, metavar="DIR", help="folder of studies, as reports")
    parser.add_argument("--out", type=Path, help="folder of the leaderboard (default: DIR)")
    parser.add_argument("--baseline", default="", metavar="METHOD", help=BASELINE_HELP)
    options = parser.parse_args(arguments)
    out_dir = options.out or options.folder
    path, studies, verdict = leaderboard(options.folder, out_dir, options.baseline)
    tell("leaderboard", path, verdict)
    require(
        studies > 0,
        f"{options.folder}: expected a study with a finished run, got none; the leaderboard says"
        " why each is left out",
    )
    return 0
