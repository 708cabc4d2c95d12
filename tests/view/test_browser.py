"""The page in a real headless browser, and its pictures against our own renders. It needs node, a
Chromium and puppeteer-core (npm), given by `FISHERSPLAT_BROWSER` (the executable) and
`FISHERSPLAT_PUPPETEER` (the package's main module)."""

import base64
import json
import os
import shutil
import subprocess
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from framework.kernels import rasterize
from framework.metrics.evaluate import quantise
from framework.records.ply import write_ply
from framework.view.page import view_page
from framework.view.runs import read_viewed
from framework.view.server import PageServer
from tests.view.runs import NEAR, scene_gaussians, seen_run, views

SCRIPT = Path(__file__).with_name("browser.mjs")
HOSTILE = '<img src=x onerror=alert(1)>"</script><script>alert(2)</script>'
SAME = (1.0, 1.0, 1.0)  # exposed as the model is
LEAST_DB = 45.0  # the page blends half floats; measured: 50 and more


Browse = Callable[[str], dict[str, Any]]


@pytest.fixture
def browse() -> Browse:
    """What `browser.mjs` reports about the page at an address."""
    browser = os.environ.get("FISHERSPLAT_BROWSER")
    library = os.environ.get("FISHERSPLAT_PUPPETEER")
    node = shutil.which("node")
    if not (browser and library and node):
        pytest.skip("needs node, FISHERSPLAT_BROWSER and FISHERSPLAT_PUPPETEER")

    def told(page: str) -> dict[str, Any]:
        command = [node, str(SCRIPT), library, browser, page]
        done = subprocess.run(command, capture_output=True, text=True, timeout=400)
        assert done.returncode == 0, done.stderr
        return dict(json.loads(done.stdout))

    return told


def scene_run(folder: Path, banded: int = 250, seed: int = 3, **more: Any) -> Path:
    """A made-up run with Gaussians to look at, not all with spherical harmonics."""
    run = seen_run(folder, **more)
    write_ply(run / "point_cloud.ply", *scene_gaussians(400, banded, seed))
    return run


def check(message: dict[str, Any]) -> None:
    """What holds of every page."""
    for actual in message.values():
        assert actual["problems"] == [] and actual["overflow"] == 0 and actual["fits"]
        assert actual["stage"] > 0.5
        assert actual["first"].startswith("Test camera test 00 · PSNR")
        assert actual["second"].startswith("Test camera test 01")
        assert actual["again"] == actual["first"]
        assert actual["photo"] and actual["loaded"] == 64 and actual["beside"]
        assert actual["clips"][0] < 20 < actual["clips"][1]
        for deed in ("turned", "closer", "hidden", "flown", "home", "help"):
            assert actual[deed], deed
    assert message["wide"]["background"] != message["phone"]["background"]  # light and dark


def psnr_of(picture: list[Any], run: Path, camera: Any, exposure: Sequence[float] = SAME) -> float:
    """dB of the page's picture against our render of the run, both of 8 bits."""
    from framework.records.ply import read_ply

    gaussians, background = read_ply(run / "point_cloud.ply")
    rgb = rasterize(gaussians, camera, background=background, near=NEAR).rgb.detach()
    ours = quantise(rgb * torch.tensor(exposure)[:, None, None])
    width, height, data = picture
    pixels = np.frombuffer(base64.b64decode(data), np.uint8).reshape(height, width, 4)[..., :3]
    error = np.mean((pixels.astype(float) - ours.astype(float)) ** 2)
    return float(10 * np.log10(255**2 / max(error, 1e-9)))


def test_the_page_works_and_shows_what_we_render(tmp_path: Path, browse: Browse) -> None:
    run = scene_run(tmp_path, scene=HOSTILE, run_name="x")
    with PageServer(view_page([read_viewed(run)])) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        message = browse(server.address)
        server.shutdown()
    check(message)
    training, tested = views()
    assert message["wide"]["names"] == [view.name for view in [*tested, *training]]
    for view, pictures in zip([*tested, *training], message["wide"]["pictures"], strict=True):
        assert psnr_of(pictures[0], run, view.camera) > LEAST_DB
