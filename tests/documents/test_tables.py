"""Tables of README and docs are those that the records of committed studies give."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from framework.command.config.schema import ROOT

SCRIPT = "benchmarks/results.py"


@pytest.fixture(scope="module")
def results() -> object:
    import importlib.util

    spec = importlib.util.spec_from_file_location("results", ROOT / SCRIPT)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_tables_are_those_of_the_committed_studies() -> None:
    """As `python benchmarks/results.py tables` writes them."""
    command = [sys.executable, SCRIPT, "tables", "--check"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_a_changed_number_of_a_table_is_replaced(results) -> None:  # type: ignore[no-untyped-def]
    page = "before\n\n<!-- table: t -->\n\n| a |\n| --- |\n| 1 |\n\nafter\n"
    rows = ["| a |", "| --- |", "| 2 |"]
    assert results.with_table(page, "t", rows) == page.replace("| 1 |", "| 2 |")
    assert results.with_table(results.with_table(page, "t", rows), "t", rows).count("| 2 |") == 1
    with pytest.raises(ValueError, match="table: other"):
        results.with_table(page, "other", rows)


def test_options_of_a_study_replace_those_of_its_scene(results) -> None:  # type: ignore[no-untyped-def]
    canon = {
        "scenes": {"fern": "scene=llff scene.path={data}/fern scene.n_views=3"},
        "methods": "a,b",
    }
    study = {"options": "scene.n_views=2,3 method={methods}"}
    (words,) = results.commands_of(canon, "views", study, Path("/my data"))
    assert words == [
        "scene=llff",
        "scene.path=/my data/fern",
        "scene.n_views=2,3",
        "scene.downscale=2",
        "method=a,b",
        "study=results_views",
    ]


def test_a_committed_report_links_to_nothing_absent(results, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    (tmp_path / "kept.png").touch()
    chart = "![a](kept.png)\n\nA chart.{}\n\n"
    page = chart.format(" [SVG](gone.svg) [CSV](gone.csv)") + "![b](gone.png)\n\nGone.\n\nText.\n"
    assert results.without_absent(page, tmp_path) == chart.format("") + "Text.\n"
