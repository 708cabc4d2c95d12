"""Most tests of reports read the text alone, and drawing the charts is most of a report's time."""

import io
from pathlib import Path

import pytest
from PIL import Image

from framework.report.figures import chart

DRAWING = ("test_browser", "test_figures", "test_page", "test_report")  # look at the charts


@pytest.fixture(autouse=True)
def blank_charts(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Charts are pictures of one pixel, but in the modules that look at them."""
    if request.module.__name__.rpartition(".")[2] not in DRAWING:
        monkeypatch.setattr(chart, "save", save_blank)


def save_blank(figure: object, folder: Path, name: str, kind: str) -> bytes:
    buffer = io.BytesIO()
    if kind == "png":
        Image.new("RGB", (1, 1)).save(buffer, "PNG")
    else:
        buffer.write(b'<svg xmlns="http://www.w3.org/2000/svg"/>')
    (folder / f"{name}.{kind}").write_bytes(buffer.getvalue())
    return buffer.getvalue()
