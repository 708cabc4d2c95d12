"""`fishersplat leaderboard DIR`: what all studies of a folder say about every method.

Studies differ in scenes, resolution and budget, so their PSNRs are not ranked against each other.
What adds up is every method against the baseline of its own study: really better, really worse, or
not told apart, each with the interval that its own report draws.
"""

from __future__ import annotations

import csv
import io
import itertools
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

from framework.errors import Arguments, UserError, printable_line, require
from framework.files.limits import RUNS
from framework.files.whole import make_folder, write_whole
from framework.records import RUN_FOLDERS
from framework.records.archive import ARCHIVE
from framework.report.figures.files import forest_picture
from framework.report.page import html as page
from framework.report.page import markdown
from framework.report.page.gallery import Gallery
from framework.report.parts.document import Block, Document, Heading, Link, Text, table
from framework.report.parts.forest import Forest, Row
from framework.report.parts.palette import looks
from framework.report.statistics.compare import Comparison
from framework.report.statistics.numbers import ABSENT, interval_text, mean_text, p_text, signed
from framework.report.statistics.outcomes import Outcomes, outcomes
from framework.report.study.collect import collect
from framework.report.study.folders import holds_run, walked
from framework.report.study.labels import listed, outside
from framework.report.study.order import method_order, natural
from framework.report.study.runs import Study
from framework.scenes import HELD_OUT

REPORT, PAGE, TABLE = "leaderboard.md", "leaderboard.html", "leaderboard.csv"
WORDS = ("Study", "Use", "Method", "Scenes", "Against", "Why", "Told")
MIN_SPAN_DB, MOST_ROWS = 0.5, 80
RANKED = (
    "Every method against the baseline of its study, at an equal budget. A difference is real where"
    " the interval of its study, corrected for all comparisons there, excludes zero. Methods stand"
    " by how much oftener they are really better than worse, then by their mean difference. A study"
    " of a stress counts by the mean over its strengths, which finds smaller differences than its"
    " report does at one. Studies share scenes and seeds, so these are no independent votes."
)
EVERY = "Budgets and capacities of one method against each other are here, too; they have no rank."
DRAWN = (
    "Difference of test PSNR to the baseline of the same study and budget, to the right: better."
    " Bars: 95 % intervals that hold for all comparisons of that study at once; a filled mark is"
    " really different from zero."
)


@dataclass(frozen=True)
class Entry:
    """A study with its outcomes. name: its folder below the one that was given."""

    name: str
    study: Study
    found: Outcomes


@dataclass(frozen=True)
class Match:
    """A comparison of a study. family: its method without the budget. ranked: with another method,
    not with another budget of the same one."""

    entry: Entry
    family: str
    comparison: Comparison
    ranked: bool


def leaderboard(folder: Path, out_dir: Path) -> tuple[Path, int]:
    """Write the leaderboard of all studies below the folder; returns its path, and how many are in
    it. Raises UserError where there is none. Studies that cannot be read are told."""
    entries, broken = _entries(folder, out_dir)
    require(
        bool(entries or broken),
        f"{folder}: expected studies with runs, or with a runs.csv, below this folder, got none;"
        " give the folder that holds them, as reports",
    )
    matches = [match for entry in entries for match in _matches(entry)]
    make_folder(out_dir)
    ranked = [match for match in matches if match.ranked]
    blocks = [*_opening(entries, ranked), *_drawn(ranked, out_dir)]
    blocks += [*_studies(entries, out_dir), *_broken(broken)]
    if matches:
        blocks += [Heading(2, "Every comparison"), table(_rows(matches), WORDS), Text(EVERY)]
    families = sorted({match.family for match in matches}, key=method_order)
    made = Document("Leaderboard", tuple(blocks), (), tuple(families))
    write_whole(out_dir / PAGE, page.render(made, Gallery(), out_dir))
    write_whole(out_dir / TABLE, _csv(matches))
    write_whole(out_dir / REPORT, markdown.render(made))
    return out_dir / REPORT, len(entries)


def _entries(folder: Path, out_dir: Path) -> tuple[list[Entry], dict[str, str]]:
    """The studies: folders with a table of runs, or with runs in `runs/`; and why others are not
    read."""
    found: list[Entry] = []
    broken: dict[str, str] = {}
    for path in _study_dirs(folder):
        name = outside(os.path.relpath(path, folder)) if path != folder else outside(path.name)
        try:
            study = collect(path, out_dir)
        except UserError as error:
            broken[name] = outside(str(error))
            continue
        if study.runs and (why := _chose(study)):
            broken[name] = why
        elif study.runs:
            found.append(Entry(name, study, outcomes(study)))
        else:
            broken[name] = "no run of it finished"
    return sorted(found, key=lambda entry: natural(entry.name)), broken


def _chose(study: Study) -> str:
    """Why a study judges no method, as its runs were made to choose options; "" where it does."""
    if study.searched is not None:
        return "the trials of a search, which were made to choose options"
    held = sorted({run.protocol for run in study.runs if run.protocol.endswith(HELD_OUT)})
    return f"judged by training photos (scene.split={outside(held[0])})" if held else ""


def _study_dirs(folder: Path) -> list[Path]:
    """The folder itself and those below it, as far as they are studies, sorted."""
    found = {folder} if (folder / RUN_FOLDERS).is_dir() else set()
    for here, names in walked(folder):
        inside = here.relative_to(folder).parts
        if inside and holds_run(names):
            found.add(_study_of(folder, inside))
        elif ARCHIVE in names and RUN_FOLDERS not in inside:
            found.add(here)
    require(len(found) <= RUNS, f"{folder}: expected at most {RUNS:,} studies, got more")
    return sorted(found)


def _study_of(folder: Path, inside: tuple[str, ...]) -> Path:
    """Of which study a run is, whose folder lies so `inside`: that with the `runs` it is in, else
    the one above it."""
    place = inside.index(RUN_FOLDERS) if RUN_FOLDERS in inside[:-1] else len(inside) - 1
    return folder.joinpath(*inside[:place])


def _names(study: Study, scenes: Sequence[str]) -> int:
    """How many scenes these are; conditions of one are one."""
    return len({study.name_of(scene) for scene in scenes})


def _matches(entry: Entry) -> list[Match]:
    families = entry.study.family_of
    known = [c for c in entry.found.comparisons.values() if c.joint is not None]
    return [
        Match(entry, families[c.method], c, families[c.method] != families[c.baseline])
        for c in known
    ]


def _opening(entries: Sequence[Entry], matches: Sequence[Match]) -> list[Block]:
    rows = _ranked(matches)
    better = [match.family for match in matches if _sign(match) > 0]
    worse = [match.family for match in matches if _sign(match) < 0]
    studies = len({match.entry.name for match in matches})
    said = (
        f"Of {len(matches)} comparisons of methods in {studies} studies, really better than"
        f" the baseline: {_named(better)}; really worse: {_named(worse)}."
    )
    blocks: list[Block] = [Heading(1, "Leaderboard"), Text(said, "verdict")]
    return [*blocks, table(rows, WORDS), Text(RANKED)] if rows else blocks


def _named(families: Sequence[str]) -> str:
    counts = {family: families.count(family) for family in sorted(set(families), key=method_order)}
    told = [f"{family} ({n})" for family, n in counts.items()]
    return listed(told, "and") if told else "nobody"


def _sign(match: Match) -> int:
    if not match.comparison.significant:
        return 0
    return 1 if match.comparison.difference > 0 else -1


def _ranked(matches: Sequence[Match]) -> list[dict[str, str | Link]]:
    rows = []
    for family in sorted({match.family for match in matches}, key=method_order):
        own = [match for match in matches if match.family == family]
        signs = [_sign(match) for match in own]
        differences = [match.comparison.difference for match in own]
        mean = sum(differences) / len(own)
        row: dict[str, str | Link] = {
            "Method": family,
            "Studies": str(len({match.entry.name for match in own})),
            "Comparisons": str(len(own)),
            "Really better": str(signs.count(1)),
            "Not told apart": str(signs.count(0)),
            "Really worse": str(signs.count(-1)),
            "Mean difference (dB)": signed(mean),
            "Lowest to highest (dB)": f"{signed(min(differences))} to {signed(max(differences))}",
        }
        rows.append((-sum(signs), -mean, row))
    return [row for *_, row in sorted(rows, key=lambda entry: entry[:2])]


def _studies(entries: Sequence[Entry], out_dir: Path) -> list[Block]:
    rows = []
    for entry in entries:
        study, found = entry.study, entry.found
        best = _used(study, found)
        values = list(found.seeds.get(best, {}).values())
        runs = study.of(method=best)
        row: dict[str, str | Link] = {
            "Study": _link(entry, out_dir),
            "Use": best if _matches(entry) else "no advice",
            "Scenes": str(_names(study, study.scenes)),
            "Seeds": str(len(values)),
            "Methods": str(len(study.methods)),
            "PSNR (dB)": mean_text(values, 2, show_half=True) if values else ABSENT,
            "Gaussians": mean_text([float(run.record.gaussians) for run in runs], 0),
            "Train, CPU (s)": mean_text([run.record.train_cpu_s for run in runs], 1),
        }
        rows.append(row)
    text = "PSNR, Gaussians and seconds: of what to use, over the scenes or strengths of the study."
    blocks = [Heading(2, "Studies"), table(rows, WORDS), Text(text), *_shared(entries)]
    return blocks if rows else []


def _shared(entries: Sequence[Entry]) -> list[Block]:
    """Which studies have trainings in common, by the bits of their parameters."""
    bits = {
        entry.name: {run.record.parameters_sha256 for run in entry.study.runs} - {""}
        for entry in entries
    }
    told = [
        f"{one} and {other} ({len(both)})"
        for one, other in itertools.combinations(bits, 2)
        if (both := bits[one] & bits[other])
    ]
    if not told:
        return []
    return [Text(f"Trainings that are in two studies count in both: {listed(told, 'and')}.")]


def _used(study: Study, found: Outcomes) -> str:
    """What the verdict advises; of the baseline with several budgets, the highest."""
    best = found.best
    if best != study.baseline_of(best) or not study.has_budgets:
        return best
    own = {run.method for run in study.runs if run.method_label.family == study.families[0]}
    return max(own & found.psnr.keys(), key=lambda m: (found.psnr[m].mean, m), default=best)


def _link(entry: Entry, out_dir: Path) -> str | Link:
    """To the report of a study, where it has one."""
    folder = entry.study.runs[0].run.run_dir.parent.parent
    report = folder / "report.md"
    if not report.is_file():
        return entry.name
    way = Path(os.path.relpath(report.resolve(), out_dir.resolve())).as_posix()
    return Link(entry.name, quote(os.fsencode(way)))


def _broken(broken: dict[str, str]) -> list[Block]:
    if not broken:
        return []
    rows = [{"Study": name, "Why": why} for name, why in sorted(broken.items())]
    return [Heading(2, "Not read"), table(rows, WORDS)]


def _drawn(matches: Sequence[Match], out_dir: Path) -> list[Block]:
    """A forest plot by method and study; of very many, those that are really different."""
    shown = sorted(matches, key=lambda m: (method_order(m.family), natural(m.entry.name)))
    if len(shown) > MOST_ROWS:
        shown = [match for match in shown if _sign(match)][:MOST_ROWS]
    if not shown:
        return []
    given = looks([match.family for match in shown])
    rows = []
    for match in shown:
        c = match.comparison
        assert c.joint is not None, "only what was tested is a match"
        budget = c.method.removeprefix(match.family).strip(", ")
        label = f"{match.entry.name}{f', {budget}' if budget else ''}"
        ends = (c.difference, c.joint.low, c.joint.high)
        rows.append(Row(match.family, label, given[match.family], *ends, True, c.significant))
    x_label = "PSNR above the baseline of the study (dB)"
    plot = Forest("leaderboard", "the baseline of the study", x_label, tuple(rows), MIN_SPAN_DB)
    alt = "Differences to the baseline by method and study"
    left = "" if len(shown) == len(matches) else " Only what is really different is drawn."
    return [Heading(2, "By method and study"), forest_picture(out_dir, plot, alt, DRAWN + left)]


def _rows(matches: Sequence[Match]) -> list[dict[str, str]]:
    rows = []
    for match in matches:
        c = match.comparison
        assert c.joint is not None and c.p_joint is not None, "only what was tested is a match"
        rows.append(
            {
                "Study": match.entry.name,
                "Method": c.method,
                "Against": c.baseline,
                "Scenes": str(_names(match.entry.study, c.scenes)),
                "Seeds": str(c.n),
                "ΔPSNR (dB)": signed(c.difference),
                "95 %, corrected": interval_text(c.joint),
                "p": p_text(c.p_joint),
                "Told": {1: "better", 0: "", -1: "worse"}[_sign(match)],
            }
        )
    return rows


def _csv(matches: Sequence[Match]) -> str:
    """Every comparison in full digits."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    names = ("study", "method", "against", "scenes", "seeds", "difference_db", "low", "high", "p")
    writer.writerow(names)
    for match in matches:
        c = match.comparison
        ends = (None, None) if c.joint is None else (c.joint.low, c.joint.high)
        scenes = _names(match.entry.study, c.scenes)
        told = (match.entry.name, c.method, c.baseline, scenes, c.n)
        writer.writerow([*told, c.difference, *ends, c.p_joint])
    return buffer.getvalue()


def main(arguments: list[str], prog: str) -> int:
    """The subcommand; exit status 0. Raises UserError for bad input, also where the leaderboard,
    which is written all the same, has no study."""
    text = "What all studies of a folder say about every method, from their runs or their runs.csv."
    parser = Arguments(prog=prog, description=text)
    parser.add_argument("folder", type=Path, metavar="DIR", help="folder of studies, as reports")
    parser.add_argument("--out", type=Path, help="folder of the leaderboard (default: DIR)")
    options = parser.parse_args(arguments)
    path, studies = leaderboard(options.folder, options.out or options.folder)
    print(f"leaderboard: {printable_line(str(path))}")
    require(
        studies > 0,
        f"{options.folder}: expected a study with a finished run, got none; the leaderboard tells"
        " why each is not read",
    )
    return 0
