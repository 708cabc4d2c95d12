"""The report of made-up studies: first screen, findings, figures, and the same bytes twice."""

import csv
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy import stats

from framework.command.cli import main as command
from framework.records.provenance import ROOT
from framework.records.record import write_failed
from framework.report import build_report
from framework.report.figures.views import choose_views
from framework.report.study.collect import collect
from tests.record.fakes import fake_run, make_config


@pytest.fixture(scope="module")
def study_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("reports") / "embedded"
    for augment, reg, gain in (("none", "none", 0.0), ("safi", "uar", 2.0)):
        for seed in range(3):
            fake_run(folder, augment, reg, seed, gain)
    write_failed(folder / "runs" / "x", make_config(seed=9), ["seed=9"], "depth: a | b")
    build_report(folder)
    return folder


@pytest.fixture(scope="module")
def report(study_dir: Path) -> str:
    return (study_dir / "report.md").read_text(encoding="utf-8")


def test_sections_are_in_the_order_of_a_paper(report: str) -> None:
    title, _, verdict, *_ = report.splitlines()
    assert title == "# embedded" and verdict.startswith("**Use SAFI + UAR: it gains ")
    assert "**Note.** 1 of 7 runs failed: listed below." in report
    sections = re.findall(r"^## (.*)$", report, re.MULTILINE)
    assert sections == [
        *("Results", "Comparisons", "Pictures"),
        *("Speed, accuracy and size", "Diagnostics", "Appendix"),
    ]
    links = re.findall(r"\[([^]]*)\]\(#", report)
    assert links == sections, "a table of contents"


def test_results_for_a_paper(study_dir: Path) -> None:
    """PSNR and SSIM, mean ± sigma with fixed decimals; the best bold, the second underlined."""
    latex, markdown, table = (
        (study_dir / f"results.{kind}").read_text(encoding="utf-8") for kind in ("tex", "md", "csv")
    )
    best = re.search(r"SAFI \+ UAR & \\textbf\{(\d\d\.\d\d)\} \$\\pm\$ (\d\.\d\d) & ", latex)
    assert best is not None and "Baseline & \\underline{" in latex and "\\toprule" in latex
    assert f"**{best[1]}** ± {best[2]}" in markdown and "<u>" in markdown
    assert f"**{best[1]}** ± {best[2]}" in (study_dir / "report.md").read_text(encoding="utf-8")
    header, *rows = csv.reader(table.splitlines())
    assert header == ["method", "psnr", "psnr_sigma", "ssim", "ssim_sigma"]
    assert [row[0] for row in rows] == ["Baseline", "SAFI + UAR"] and rows[1][1:3] == [
        *best.groups()
    ]


def test_table_numbers_are_the_records(study_dir: Path, report: str) -> None:
    runs = [run for run in collect(study_dir).runs if str(run.method) == "SAFI + UAR"]
    values = [float(run.run.metrics.numbers["psnr"].mean()) for run in runs]
    results = report.partition("underlined.")[2]
    row = next(line for line in results.splitlines() if line.startswith("| SAFI + UAR"))
    cells = [cell.strip() for cell in row.strip("|").split("|")]
    half = stats.t.ppf(0.975, 2) * np.std(values, ddof=1) / 3**0.5
    assert cells[1] == f"{np.mean(values):.2f} ± {half:.2f}"
    assert cells[2].startswith(f"{np.std(values, ddof=1):.2f} [")
    assert cells[5] == "18.1" and cells[7] == "12"


def test_rebuilding_gives_the_same_bytes(study_dir: Path, report: str) -> None:
    def contents() -> dict[str, bytes]:
        return {path.name: path.read_bytes() for path in study_dir.iterdir() if path.is_file()}

    before = contents()
    # another process: other hash seeds, other object ids
    command = [sys.executable, "run.py", "report", str(study_dir)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    verdict, *paths = done.stdout.splitlines()
    assert verdict.startswith("Use SAFI + UAR: it gains")
    assert paths == [f"page: {study_dir / 'report.html'}", f"report: {study_dir / 'report.md'}"]
    assert set(before) == {
        *("report.md", "report.html", "runs.csv", "runs.jsonl"),
        *("results.tex", "results.md", "results.csv"),
        *("curves_embedded.png", "curves_embedded.svg"),
        *("tradeoff_embedded.png", "tradeoff_embedded.svg", "tradeoff_embedded.csv"),
        *("differences.png", "differences.svg", "differences.csv"),
        *("closeup_embedded.jpg", "curves_embedded.csv"),
    }
    assert contents() == before


def test_images_are_of_the_same_views_and_seed(study_dir: Path) -> None:
    runs, views = choose_views(collect(study_dir), "embedded")
    assert [run.seed for run in runs] == [0, 0]
    assert views == {
        "test 01": "interpolating, median",
        "test 03": "extrapolating, median; worst",
    }
    with Image.open(study_dir / "closeup_embedded.jpg") as image:
        assert image.width == 792 and len(np.unique(np.asarray(image.convert("L")))) > 100


def test_failed_missing_and_repeated_runs_are_told_first_and_the_report_builds(
    tmp_path: Path,
) -> None:
    for augment in ("none", "safi"):
        for seed in range(3):
            fake_run(tmp_path, augment, seed=seed)
    shutil.copytree(tmp_path / "runs/embedded-safi-none-s2", tmp_path / "runs/z")
    shutil.rmtree(tmp_path / "runs/embedded-none-none-s1")
    write_failed(tmp_path / "runs" / "x", make_config("safi", "uar"), ["seed=0"], "no overlap")
    text = build_report(tmp_path).path.read_text(encoding="utf-8")
    first_screen = text.partition("\n## ")[0]
    assert "1 of 6 runs failed and 1 run is missing: listed below." in first_screen
    assert "No run finished of SAFI + UAR." in first_screen
    assert "ran twice" in first_screen
    assert "- Baseline on embedded: seed 1" in text and "no overlap" in text


def test_studies_are_merged_on_the_command_line(tmp_path: Path) -> None:
    for seed in range(2):
        fake_run(tmp_path / "a", seed=seed)
        fake_run(tmp_path / "b", "safi", seed=seed, gain=1.0)
    folders = [str(tmp_path / name) for name in "ab"]
    assert command(["report", *folders, "--out", str(tmp_path / "both"), "--title", "Both"]) == 0
    text = (tmp_path / "both" / "report.md").read_text(encoding="utf-8")
    assert text.startswith("# Both\n") and "- SAFI: " in text
    assert "](../b/runs/embedded-safi-none-s1/)" in text
    assert command(["report", *folders]) == 2


def test_a_report_can_be_built_without_photos(tmp_path: Path) -> None:
    """It keeps the pictures of the embedded scene."""
    for name in ("fern", "embedded"):
        loader = {"name": "embedded" if name == "embedded" else "llff"}
        for method in ("none", "safi"):
            fake_run(tmp_path / "study", method, scene=name, condition=loader)
    out = tmp_path / "out"
    line = [str(tmp_path / "study"), "--out", str(out)]
    assert command(["report", *line]) == 0 and (out / "closeup_fern.jpg").exists()
    assert "/runs/" in (out / "report.md").read_text(encoding="utf-8")
    # of a report in which the scene was called so
    shutil.copy(out / "closeup_fern.jpg", out / "closeup_fern_n_views_3.jpg")
    (out / "images_notes.txt").write_text("mine", encoding="utf-8")
    assert command(["report", *line, "--without-photos"]) == 0
    assert (out / "images_notes.txt").exists()
    text = (out / "report.md").read_text(encoding="utf-8")
    assert "/runs/" not in text and "fern-safi-none-s0" in text
    assert "No pictures of fern: this report was built without photos" in text
    assert {path.name for path in out.glob("*.jpg")} == {"closeup_embedded.jpg"}
    shots = re.search(r'"shots": ?(\[.*?\]\])', (out / "report.html").read_text(encoding="utf-8"))
    assert shots is not None and "embedded" in shots[1] and "fern" not in shots[1]


def test_bad_folder_on_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert command(["report", str(tmp_path / "nothing")]) == 2
    errors = capsys.readouterr().err
    assert errors.startswith("error: ") and errors.count("\n") == 1
