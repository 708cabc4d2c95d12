"""Most tests of reports read the text alone, and drawing the charts is most of a report's time."""

from __future__ import annotations

import io
from pathlib import Path

import pytest
from PIL import Image

from framework.report.figures import files

DRAWING = ("test_browser", "test_figures", "test_palette", "test_report")  # look at the charts


@pytest.fixture(autouse=True)
def blank_charts(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Charts are pictures of one pixel, but in the modules that look at them."""
    if request.module.__name__.rpartition(".")[2] not in DRAWING:
        monkeypatch.setattr(files, "_save", save_blank)


def save_blank(figure: object, folder: Path, name: str) -> None:
    buffer = io.BytesIO()
    Image.new("RGB", (1, 1)).save(buffer, "PNG")
    (folder / f"{name}.png").write_bytes(buffer.getvalue())
    (folder / f"{name}.svg").write_text('<svg xmlns="http://www.w3.org/2000/svg"/>')
