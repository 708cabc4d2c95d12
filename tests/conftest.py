"""No test depends on the user's cache; a missing kernel cache is reported."""

from pathlib import Path

import pytest

from framework.compute.jit import KERNEL_CACHE
from framework.metrics import lpips_weights


def pytest_sessionstart(session: pytest.Session) -> None:
    """Say why the first tests may take so long."""
    terminal = session.config.pluginmanager.get_plugin("terminalreporter")  # none in a worker
    if terminal is not None and next(KERNEL_CACHE.rglob("*.nbi"), None) is None:
        terminal.write_line("kernels are compiled now, for about a minute; once for these sources")


@pytest.fixture(autouse=True)
def no_fetched_weights(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """LPIPS is missing unless a test fetches weights."""
    monkeypatch.setattr(lpips_weights, "cache_dir", lambda: tmp_path / "fetched")
