"""No test depends on what the user's cache holds; where it holds no kernels, that is told."""

from __future__ import annotations

from pathlib import Path

import pytest

from framework.compute.jit import KERNEL_CACHE
from framework.metrics import lpips_weights


def pytest_report_header() -> str | None:
    """Why the first tests may take so long."""
    if next(KERNEL_CACHE.rglob("*.nbi"), None) is not None:
        return None
    return "kernels: compiled now, for about a minute; once for these sources"


@pytest.fixture(autouse=True)
def no_fetched_weights(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """LPIPS is missing unless a test fetches weights of its own."""
    monkeypatch.setattr(lpips_weights, "cache_dir", lambda: tmp_path / "fetched")
