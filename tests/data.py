"""Real scenes for tests: the folder `shared/data/open` beside the checkout, if it is there."""

from pathlib import Path

import pytest

OPEN = Path(__file__).resolve().parents[2] / "shared" / "data" / "open"


def open_scene(name: str) -> Path:
    """The folder of the real scene `name`; the test is skipped where it is missing."""
    folder = OPEN / name
    if not folder.is_dir():
        pytest.skip(f"the real scene '{name}' is not here (expected {OPEN.name}/{name})")
    return folder
