"""The undisturbed study that every disturbed one must equal."""

from pathlib import Path

import pytest

from benchmarks.studies import digests
from framework.command import cli
from framework.compute.rng import stream
from tests.system.forked import STUDY, Place


@pytest.fixture(scope="session")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Digests of its files. This process runs it, so later forks find kernels and modules ready."""
    folder = tmp_path_factory.mktemp("undisturbed")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert cli.main(list(STUDY)) == 0
    return digests(folder / "reports" / "disturbed")


@pytest.fixture
def place(request: pytest.FixtureRequest, tmp_path: Path) -> Place:
    """An empty folder; the draws differ from test to test."""
    return Place(tmp_path, stream(0, f"system/{request.node.name}"))
