"""No test depends on what the user's cache holds."""

from __future__ import annotations

from pathlib import Path

import pytest

from framework.metrics import lpips_weights


@pytest.fixture(autouse=True)
def no_fetched_weights(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """LPIPS is missing unless a test fetches weights of its own."""
    monkeypatch.setattr(lpips_weights, "cache_dir", lambda: tmp_path / "fetched")
