"""No test depends on the user's cache; a missing kernel cache is reported, and filled once."""

from pathlib import Path

import pytest

from framework.compute.jit import KERNEL_CACHE
from framework.metrics import lpips_weights

TESTS = Path(__file__).parent
WITHOUT_KERNELS = ("record", "report", "scenes", "security")


def pytest_sessionstart(session: pytest.Session) -> None:
    """Say why the first tests may take so long."""
    terminal = session.config.pluginmanager.get_plugin("terminalreporter")  # none in a worker
    if terminal is not None and next(KERNEL_CACHE.rglob("*.nbi"), None) is None:
        terminal.write_line("kernels are compiled now, for about a minute; once for these sources")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put tests that need no kernels at the middle, where the second of two workers begins.

    Otherwise both compile the same kernels at the same time.
    """
    parts = {item: item.path.relative_to(TESTS).parts[0] for item in items}
    free = [item for item in items if parts[item] in WITHOUT_KERNELS]
    others = [item for item in items if parts[item] not in WITHOUT_KERNELS]
    half = len(items) // 2
    items[:] = [*others[:half], *free, *others[half:]]


@pytest.fixture(autouse=True)
def no_fetched_weights(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """LPIPS is missing unless a test fetches weights."""
    monkeypatch.setattr(lpips_weights, "cache_dir", lambda: tmp_path / "fetched")
