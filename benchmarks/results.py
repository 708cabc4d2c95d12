"""Run the studies behind the numbers of README and docs, and write the numbers into the pages.

    python benchmarks/results.py run DATA [--study NAME ...] [--scene NAME ...] [--estimate]
    python benchmarks/results.py keep [--study NAME ...]
    python benchmarks/results.py pages [--check]

`run` trains what `benchmarks/canonical.yaml` lists, from one commit without local changes, two runs
at a time. It can be repeated: finished runs are kept. `keep` copies what was run to
`reports/committed`; `pages` writes the tables of the pages, and the numbers in their sentences
(`benchmarks/quoted.py`), from there.
"""

from __future__ import annotations

import argparse
import difflib
import json
import re
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml
from PIL import Image

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))  # this checkout's packages

from benchmarks import quoted
from benchmarks.quoted import COMMITTED, ROOT

REPORTS = ROOT / "reports"
PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")))
PREFIX = "results_"  # of a study's folder while its runs are there
PAGE, ARCHIVE = "report.md", "runs.jsonl"
PICTURES = 5  # the first of a report, which are committed
PICTURE = re.compile(r"^!\[[^\n]*\]\(([^)]+\.png)\)", re.M)
HISTORY = ("step", "seconds", "test_psnr", "gaussians", "loss")  # columns that are kept
OPTIONS = (
    "hydra/launcher=joblib",
    "hydra.launcher.n_jobs=2",
    "threads=1",
    "metrics.lpips_both=true",
)
COLUMNS = {"psnr": "PSNR ↑", "ssim": "SSIM ↑", "lpips_01": "LPIPS ↓"}
MEASURES = {"train_cpu_s": "CPU seconds", "gaussians": "Gaussians"}


def main(arguments: Sequence[str]) -> int:
    """Returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=_Plain)
    commands = parser.add_subparsers(dest="command", required=True)
    run = commands.add_parser("run", help="train the studies")
    run.add_argument("data", type=Path, help="folder of the scenes")
    run.add_argument("--estimate", action="store_true", help="only estimate time and disk space")
    keep = commands.add_parser("keep", help="copy studies that were run to reports/committed")
    for part in (run, keep):
        part.add_argument("--study", action="append", help="by default all")
    run.add_argument("--scene", action="append", help="by default all of the study")
    pages = commands.add_parser("pages", help="write the numbers of README and docs")
    pages.add_argument("--check", action="store_true", help="only compare; 1 if one differs")
    options = parser.parse_args(arguments)
    canon = yaml.safe_load((ROOT / "benchmarks" / "canonical.yaml").read_text("utf-8"))
    if options.command == "pages":
        return write_pages(canon["tables"], options.check)
    studies = {name: canon["studies"][name] for name in options.study or canon["studies"]}
    if options.command == "keep":
        return keep_studies(studies)
    scenes = options.scene or canon["scenes"]
    return run_studies(canon, studies, scenes, options.data.resolve(), options.estimate)


class _Plain(argparse.RawDescriptionHelpFormatter):
    """Help with the lines of the description as they are."""


def run_studies(
    canon: Mapping[str, Any],
    studies: Mapping[str, Any],
    scenes: Collection[str],
    data: Path,
    estimate: bool,
) -> int:
    """Train the studies on `scenes`; a failed command does not stop the others."""
    changed = _git("status", "--porcelain", "--untracked-files=no")
    if changed and not estimate:
        print("error: expected a commit without local changes; commit or stash them")
        return 2
    print(f"commit {_git('rev-parse', 'HEAD')}", flush=True)
    failed = 0
    for name, study in studies.items():
        for words in commands_of(canon, name, study, scenes, data):
            more = ["estimate=only"] if estimate else ["estimate=false", *OPTIONS]
            start = time.monotonic()
            code = subprocess.call([sys.executable, "run.py", *words, *more, "-m"], cwd=ROOT)
            failed += code != 0
            seconds = time.monotonic() - start
            print(f"{name}: {shlex.join(words)}: exit code {code}, {seconds:.0f} s", flush=True)
        if not estimate:
            print(f"{name}: {summary(records_of(name))}", flush=True)
    return int(failed > 0)


def commands_of(
    canon: Mapping[str, Any],
    name: str,
    study: Mapping[str, Any],
    scenes: Collection[str],
    data: Path,
) -> Iterator[list[str]]:
    """The command lines of a study, one for each of `scenes` and each entry of `options`.

    Each scene has a separate folder, so that scenes can be trained on different days.
    """
    entries = study["options"] if isinstance(study["options"], list) else [study["options"]]
    for scene in study.get("scenes", canon["scenes"]):
        if scene not in scenes:
            continue
        size = "" if scene == "embedded" else f" scene.downscale={study.get('downscale', 2)}"
        place = canon["scenes"][scene] + size
        for entry in entries:  # whose options replace those of the scene
            chosen = dict(word.split("=", 1) for word in f"{place} {entry}".split())
            chosen["study"] = f"{PREFIX}{name}-{scene}"
            words = [f"{key}={value}" for key, value in chosen.items()]
            yield [word.format(data=data, methods=canon["methods"]) for word in words]


def keep_studies(studies: Mapping[str, Any]) -> int:
    """Add runs and reports of the studies to `reports/committed`.

    Runs of earlier days that are there already stay, unless they are of another commit.
    """
    for name in studies:
        new, target, source = records_of(name), COMMITTED / name, REPORTS / (PREFIX + name)
        if not new:
            print(f"{name}: no runs; python benchmarks/results.py run DATA --study {name}")
            continue
        commits = {_commit(record) for record in new.values()}
        if len(commits) > 1:
            print(f"error: {name}: expected runs of one commit, got {', '.join(sorted(commits))}")
            return 2
        kept = {k: v for k, v in _lines(target / ARCHIVE).items() if _commit(v) in commits}
        shutil.rmtree(source, ignore_errors=True)
        source.mkdir()
        lines = (_thin(line) for line in {**kept, **new}.values())
        (source / ARCHIVE).write_text("".join(f"{line}\n" for line in lines), "utf-8")
        command = ["report", str(source), "--title", name, "--without-photos", "--out", str(source)]
        subprocess.run([sys.executable, "run.py", *command], cwd=ROOT, check=True)
        shutil.rmtree(target, ignore_errors=True)
        target.mkdir(parents=True)
        page = (source / PAGE).read_text("utf-8")
        shutil.copy(source / ARCHIVE, target)
        for file in PICTURE.findall(page)[:PICTURES]:
            with Image.open(source / file) as picture:  # a third of the bytes
                picture.convert("RGB").quantize(64).save(target / file, optimize=True)
        (target / PAGE).write_text(without_absent(page, target), "utf-8")
        print(f"{name}: {summary(_lines(target / ARCHIVE))}")
    return 0


def records_of(name: str) -> dict[str, Any]:
    """The lines of the archives of all scenes of a study, by run."""
    found: dict[str, Any] = {}
    for path in sorted(REPORTS.glob(f"{PREFIX}{name}-*/{ARCHIVE}")):
        found |= _lines(path)
    return found


def _lines(path: Path) -> dict[str, Any]:
    """The lines of an archive by run; none if there is none."""
    if not path.is_file():
        return {}
    lines = map(json.loads, path.read_text("utf-8").splitlines())
    return {line["run"]: line for line in lines}


def _thin(line: dict[str, Any]) -> str:
    """A line of an archive, shortened to about a quarter of its length.

    The history keeps the steps at which test views were evaluated, and numbers seven digits.
    """
    history = line["history"]
    rows = [k for k, psnr in enumerate(history["test_psnr"]) if psnr is not None]
    short = {name: [history[name][k] for k in rows] for name in HISTORY if name in history}
    text = json.dumps({**line, "history": short})
    rounded = json.loads(text, parse_float=lambda number: float(f"{float(number):.7g}"))
    return json.dumps(rounded, separators=(",", ":"))


def _commit(line: Mapping[str, Any]) -> str:
    git = line["record"]["provenance"].get("git") or {"sha": "unknown"}  # of converted records
    return str(git["sha"])


def without_absent(page: str, folder: Path) -> str:
    """The report without pictures, with their captions, and links to files not in the folder."""

    def kept(match: re.Match[str]) -> str:
        return match[0] if (folder / match[1]).is_file() else ""

    page = re.sub(r"^!\[[^\n]*\]\(([^)]+)\)\n\n[^\n]*\n\n", kept, page, flags=re.M)
    return re.sub(r" \[(?:SVG|CSV)\]\(([^)]+)\)", kept, page)


def summary(lines: Mapping[str, Any]) -> str:
    """Runs, CPU hours, commits and processors of a study, from the lines of its archive."""
    runs, hours, commits, processors = _origin(lines)
    return f"{runs} runs, {hours} CPU hours, commit {commits}, {processors}"


def _origin(lines: Mapping[str, Any]) -> tuple[str, str, str, str]:
    records = [line["record"] for line in lines.values()]
    hours = sum(stage["cpu_s"] for record in records for stage in record["timings"]) / 3600
    commits = sorted({_commit(line)[:8] for line in lines.values()})
    processors = sorted({record["provenance"]["cpu"] for record in records})
    return f"{len(records)}", f"{hours:.1f}", ", ".join(commits), ", ".join(processors)


def write_pages(tables: Mapping[str, Any], check: bool) -> int:
    """Write the tables below their marks and the numbers inside sentences, or compare them."""
    differing = 0
    for path in PAGES:
        page = path.relative_to(ROOT).as_posix()
        text = new = path.read_text("utf-8")
        for name, spec in tables.items():
            new = with_table(new, name, table(spec)) if spec["page"] == page else new
        new = quoted.with_values(new)
        if new != text:
            differing += 1
            lines = difflib.unified_diff(
                text.splitlines(), new.splitlines(), page, page, n=0, lineterm=""
            )
            print(*lines, sep="\n")
            if not check:
                path.write_text(new, "utf-8")
    return int(check and differing > 0)


def with_table(text: str, name: str, rows: Sequence[str]) -> str:
    """The page with `rows` in place of the table after the mark of `name`."""
    head, mark, rest = text.partition(f"<!-- table: {name} -->\n")
    lines = rest.lstrip("\n").splitlines(keepends=True)
    end = next((k for k, line in enumerate(lines) if not line.startswith("|")), len(lines))
    if not mark:
        raise ValueError(f"expected the line '<!-- table: {name} -->' in the page of its table")
    return f"{head}{mark}\n" + "".join(f"{row}\n" for row in rows) + "".join(lines[end:])


def table(spec: Mapping[str, Any]) -> list[str]:
    """The lines of a table: `values`, `gains`, `recipes` or `sources`."""
    kinds = {"values": values, "gains": gains, "recipes": recipes, "sources": sources}
    return kinds[spec["kind"]](spec)


def values(spec: Mapping[str, Any]) -> list[str]:
    """Mean metrics, CPU seconds and Gaussians of methods, in groups; the best are bold."""
    names = {name: label for name, label in COLUMNS.items() if name in spec["columns"]}
    labels = ["method", *names.values(), *MEASURES.values()]
    rows = [_row(labels), _row(["---", *["---:"] * (len(labels) - 1)])]
    for group in spec["groups"]:
        shown = {
            label: quoted.means(group["study"]).loc[name] for label, name in _listed(group["rows"])
        }
        if "title" in group:
            rows.append(_row([f"*{group['title']}*", *[""] * (len(labels) - 1)]))
        texts = {
            name: [f"{m[name]:.2f}" if name == "psnr" else _short(m[name]) for m in shown.values()]
            for name in names
        }
        best = {
            name: (max if "↑" in label else min)(texts[name], key=float)
            for name, label in names.items()
        }
        for k, (label, mean) in enumerate(shown.items()):
            cells = [_bold(texts[name][k], texts[name][k] == best[name]) for name in names]
            first = _bold(label, texts["psnr"][k] == best["psnr"])
            size = f"{round(mean['gaussians'], -3):,.0f}"
            rows.append(_row([first, *cells, f"{mean['train_cpu_s']:.0f}", size]))
    return rows


def gains(spec: Mapping[str, Any]) -> list[str]:
    """Gain of each method in PSNR over the baseline, a column for each study or scene of one."""
    columns = spec["gains"]
    means = {
        label: quoted.means(column["study"], column.get("scene", ""))["psnr"]
        for label, column in columns.items()
    }
    rows = [_row(["method", *columns]), _row(["---", *["---:"] * len(columns)])]
    for label in spec["rows"]:
        cells = []
        for column, psnr in means.items():
            name = columns[column].get("names", {}).get(label, label)
            difference = psnr[name] - psnr["Baseline"] if name in psnr else None
            cells.append("" if difference is None else f"{difference:+.2f}")
        if label == "Baseline":
            label = "Baseline (3DGS), PSNR"
            cells = [f"{psnr['Baseline']:.2f}" for psnr in means.values()]
        rows.append(_row([label, *cells]))
    return rows


def recipes(spec: Mapping[str, Any]) -> list[str]:
    """Published PSNR of recipes, ours on a scene, and the difference to the baseline with its
    uncorrected interval."""
    study = spec["study"]
    labels, rows = ["recipe"], {name: [f"`{name}`"] for name in spec["rows"]}
    for data, scene in spec["scenes"].items():
        labels += [f"{data}, published", scene, "difference to 3DGS", "CPU s"]
        means = quoted.means(study, scene)
        for recipe, name in spec["rows"].items():
            source = ROOT / "conf" / "published" / f"{recipe.removesuffix('_sweep')}.yaml"
            published = yaml.safe_load(source.read_text("utf-8")).get(data, {}).get("published", "")
            difference = ""
            if name != "Baseline":
                gain = quoted.gain(study, name, on=scene, corrected=False)
                difference = f"{gain.mean:+.2f} ({gain.span})"
            mean = means.loc[name]
            cpu = f"{mean['train_cpu_s']:,.0f}"
            rows[recipe] += [published, f"{mean['psnr']:.2f}", difference, cpu]
    ordered = sorted(rows.values(), key=lambda cells: -float(cells[2]))
    lines = ["---", *["---:"] * (len(labels) - 1)]
    return [_row(labels), _row(lines), *map(_row, ordered)]


def sources(spec: Mapping[str, Any]) -> list[str]:
    """Each committed study: its report, runs, CPU hours, commit and processors."""
    rows = [_row(["study", "runs", "CPU hours", "commit", "processors"])]
    rows.append(_row(["---", "---:", "---:", "---", "---"]))
    for path in sorted(COMMITTED.glob(f"*/{ARCHIVE}")):
        link = f"[{path.parent.name}](../reports/committed/{path.parent.name}/report.md)"
        rows.append(_row([link, *_origin(_lines(path))]))
    return rows


def _listed(rows: Sequence[str | Mapping[str, str]]) -> Iterator[tuple[str, str]]:
    """Label in the page and name in the study."""
    for row in rows:
        yield from [(row, row)] if isinstance(row, str) else row.items()


def _short(value: float) -> str:
    """Three decimals without the leading zero."""
    return f"{value:.3f}".removeprefix("0")


def _bold(text: str, best: bool) -> str:
    return f"**{text}**" if best else text


def _row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _git(*words: str) -> str:
    """What a git command prints."""
    result = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True)
    return result.stdout.strip()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
