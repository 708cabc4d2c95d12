"""The page in a real headless browser. It needs node, a Chromium and puppeteer-core (npm), given by
`FISHERSPLAT_BROWSER` (the executable) and `FISHERSPLAT_PUPPETEER` (the package's main module)."""

import json
import os
import shutil
import subprocess
from pathlib import Path

import pytest

from framework.report import build_report
from tests.record.fakes import fake_run

SCRIPT = Path(__file__).with_name("browser.mjs")
HOSTILE = '<img src=x onerror=alert(1)>"</script><script>alert(2)</script>'


def test_the_page_works_in_a_browser(tmp_path: Path) -> None:
    browser = os.environ.get("FISHERSPLAT_BROWSER")
    library = os.environ.get("FISHERSPLAT_PUPPETEER")
    node = shutil.which("node")
    if not (browser and library and node):
        pytest.skip("needs node, FISHERSPLAT_BROWSER and FISHERSPLAT_PUPPETEER")
    for augment, gain in (("none", 0.0), ("safi", 1.0)):
        for seed in range(3):
            fake_run(
                tmp_path, augment, seed=seed, gain=gain, scene=HOSTILE, run_name=f"{augment}{seed}"
            )
    page = build_report(tmp_path).path.with_name("report.html")
    command = [node, str(SCRIPT), library, browser, page.as_uri()]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    message = json.loads(done.stdout)
    for actual in message.values():
        assert actual["problems"] == [] and actual["overflow"] == 0
        assert actual["clipped"] == 0 and actual["printed"] == 0
        assert actual["fewer"][0] < actual["all"][0] and actual["fewer"][1] < actual["all"][1]
        assert actual["again"] == actual["all"] and actual["besides"]
        assert actual["linked"] == [actual["fewer"][0], "Baseline", True]  # the link brings it back
        assert actual["rising"] == sorted(actual["rising"])
        assert actual["falling"] == sorted(actual["falling"], reverse=True)
        assert actual["start"] == ["inset(0px 100% 0px 0px)", "inset(0px 100% 0px 0px)"]
        assert actual["middle"] == ["inset(0px 0% 0px 0px)", "inset(0px 75% 0px 0px)"]
        assert actual["end"] == ["inset(0px 0% 0px 0px)"] * 2
        assert actual["changed"] and actual["loaded"]
    for key in ("background", "ink"):  # light and dark
        assert message["wide"][key] != message["phone"][key]
