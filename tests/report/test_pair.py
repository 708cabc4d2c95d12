"""`fishersplat compare`: two runs beside each other, and what is no pair of runs."""

import re
from pathlib import Path

import pytest

from framework.command.cli import main as command
from framework.errors import UserError
from framework.report.pair import compare_runs
from tests.record.fakes import fake_run


def test_two_runs_beside_each_other(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plain, safi = fake_run(tmp_path, run_name="a"), fake_run(tmp_path, "safi", gain=1.0)
    out = tmp_path / "out"
    assert command(["compare", str(plain), str(safi), "--out", str(out)]) == 0
    verdict, page, compared = capsys.readouterr().out.splitlines()
    assert verdict.startswith("SAFI reaches") and page == f"page: {out / 'compare.html'}"
    assert compared == f"compared: {out / 'compare.md'}"
    text = (out / "compare.md").read_text(encoding="utf-8")
    assert text.startswith("# SAFI compared with Baseline\n")
    assert re.search(r"\*\*SAFI reaches \d+\.\d\d dB on embedded, \d\.\d\d dB above", text)
    assert "Single runs cannot distinguish a method from chance" in text
    assert re.search(r"\| augment\.name +\| +none +\| +safi", text)
    for name in ("compare.html", "closeup_embedded.jpg", "curves_embedded.svg"):
        assert (out / name).is_file()
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    compare_runs(plain, safi, out)
    assert {path.name: path.read_bytes() for path in out.iterdir()} == before


def test_what_is_no_pair_of_runs_ends_in_one_line(tmp_path: Path) -> None:
    run = fake_run(tmp_path)
    with pytest.raises(UserError, match="expected the folder of a run, got none with record"):
        compare_runs(run, tmp_path, tmp_path / "out")
    with pytest.raises(UserError, match="expected two runs, got one twice"):
        compare_runs(run, run, tmp_path / "out")
