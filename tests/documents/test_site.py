"""The documentation builds as a site, offline, without a broken link."""

import subprocess
import sys
from pathlib import Path

import pytest

from framework.command.config.schema import ROOT

for package in ("mkdocs", "material", "mkdocstrings", "latex2mathml"):
    pytest.importorskip(package, reason="the extra `docs` is not installed here")


def test_it_builds_and_holds_options_contracts_and_formulas(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=400,
    )
    assert done.returncode == 0, done.stderr
    assert "reg.candidate_factor" in (tmp_path / "reference/options.html").read_text("utf-8")
    assert "pseudo_views" in (tmp_path / "reference/api.html").read_text("utf-8")
    assert "<math" in (tmp_path / "methods.html").read_text("utf-8")
    index = (tmp_path / "index.html").read_text("utf-8")
    for page in ("tutorials/plugins.html", "benchmarks.html", "reference/options.html"):
        assert page in index
    assert "fonts.googleapis" not in index
    assert 'src="http' not in index  # the search works without a network, from file:// too
    assert (tmp_path / "iframe-worker.js").is_file()
