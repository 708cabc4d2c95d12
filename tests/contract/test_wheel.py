"""A built wheel holds all that the program needs, and runs from an empty folder."""

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from framework.command.config.schema import CONF_DIR, ROOT, SWEEPS_DIR

CALL = "import sys; sys.argv[0] = 'fishersplat'; from framework.command.entry import main; main()"


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The files of a freshly built wheel, where no checkout is near."""
    pytest.importorskip("hatchling")
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    (wheel,) = folder.glob("*.whl")
    zipfile.ZipFile(wheel).extractall(folder / "site")
    return folder / "site"


def test_it_holds_every_configuration(installed: Path) -> None:
    for folder in (CONF_DIR, SWEEPS_DIR):
        there = installed / "framework" / folder.name
        wanted = {p.relative_to(folder) for p in folder.rglob("*.yaml")}
        assert wanted == {p.relative_to(there) for p in there.rglob("*.yaml")}


def test_it_runs_from_an_empty_folder(installed: Path, tmp_path: Path) -> None:
    line = ["sweep=demo", "+augment=safi", "--cfg", "job"]
    done = subprocess.run(
        [sys.executable, "-c", CALL, *line],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(installed)},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert "name: safi" in done.stdout and not list(tmp_path.iterdir())
