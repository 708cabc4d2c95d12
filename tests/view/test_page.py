"""The page of a run: what is in it and what is not, and what is said against unsound runs."""

import base64
import gzip
import hashlib
import html
import json
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from framework.command.config.schema import ROOT
from framework.errors import UserError
from framework.exports.export import main as export
from framework.records.ply import read_splats, write_ply
from framework.view.main import main
from framework.view.pack import packed
from framework.view.page import view_page
from framework.view.runs import check_together, read_exported, read_viewed
from tests.view.runs import NEAR, scene_gaussians, seen_run, views

HOSTILE = '<img src=x onerror=alert(1)>"</script><script>alert(2)</script>'


def data_of(page: str) -> dict[str, Any]:
    """What the page's script reads."""
    (text,) = re.findall(r'<script type="application/json" id="data">(.*?)</script>', page)
    return dict(json.loads(text))


def test_it_holds_the_run(tmp_path: Path) -> None:
    run = read_viewed(seen_run(tmp_path))
    page = view_page([run])
    data = data_of(page)
    training, tested = views()
    assert [c["name"] for c in data["cameras"]] == [v.name for v in [*tested, *training]]
    assert [c["role"] for c in data["cameras"]] == ["test"] * len(tested) + ["train"]
    for message, view in zip(data["cameras"], [*tested, *training], strict=True):
        assert message["rotation"] == pytest.approx(view.camera.viewmat[:3, :3].ravel().tolist())
        assert message["center"] == pytest.approx(view.camera.center.tolist())
        focal_and_center = view.camera.K[[0, 1, 0, 1], [0, 1, 2, 2]].tolist()
        assert [message[k] for k in ("fx", "fy", "cx", "cy")] == focal_and_center
    assert [c["photo"] for c in data["cameras"]] == list(range(len(tested) + 1))
    assert len(data["photos"]) == len(tested) + 1
    assert data["runs"][0]["near"] == NEAR and data["up"] == pytest.approx([0, -1, 0])
    assert data["cameras"][0]["psnr"] == [pytest.approx(27, abs=0.5)]
    assert "12 Gaussians" in page and "seed 0" in page


def test_texts_from_the_run_stay_texts(tmp_path: Path) -> None:
    folder = seen_run(tmp_path, scene=HOSTILE, run_name="x")
    message = json.loads((folder / "transforms.json").read_text())
    message["frames"][0]["file_path"] = HOSTILE
    (folder / "transforms.json").write_text(json.dumps(message))
    page = view_page([read_viewed(folder)])
    assert "<img src=x" not in page and "alert(2)</script>" not in page
    assert html.escape(HOSTILE) in page
    assert HOSTILE in [c["name"] for c in data_of(page)["cameras"]]


def test_only_its_own_script_runs_and_nothing_is_fetched(tmp_path: Path) -> None:
    page = view_page([read_viewed(seen_run(tmp_path))])
    (policy,) = re.findall(r'Content-Security-Policy" content="([^"]*)"', page)
    (script,) = re.findall(r"<script>(.*?)</script>", page, re.DOTALL)
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert f"script-src 'sha256-{digest}'" in policy and policy.startswith("default-src 'none'")
    assert "connect-src" not in policy and "unsafe" not in policy
    assert not re.search(r"https?://|(?<!:)//\w+\.\w+/", page)
    assert not re.search(r"<[^>]* (style|on\w+)=", page)


@pytest.mark.parametrize("banded", [0, 70, 200])
def test_the_packed_gaussians_are_the_run_s(tmp_path: Path, banded: int) -> None:
    gaussians, background = scene_gaussians(200, banded)
    if not banded:
        gaussians = gaussians.replace(shN=gaussians.shN.new_zeros(200, 0, 3))
    write_ply(tmp_path / "point_cloud.ply", gaussians, background)
    splats = read_splats(tmp_path / "point_cloud.ply")
    built = packed(splats)
    assert (built.n, built.banded, built.rest) == (200, banded, 15 if banded else 0)
    content = gzip.decompress(base64.b64decode(built.text))
    kinds = ["<f4", "<u2", "<i2", "<u2", "<u2", "u1"]
    sizes = [600, 600, 800, 200, 600, 45 * banded]
    arrays, at = [], 0
    for kind, size in zip(kinds, sizes, strict=True):
        arrays.append(np.frombuffer(content, kind, size, at))
        at += arrays[-1].nbytes
    assert at == len(content)
    means, scales, quats, opacities, sh0, bands = arrays
    assert np.array_equal(means.reshape(-1, 3), splats.means)
    low, high = built.log_scales
    off = low + (high - low) * scales / 65535 - splats.log_scales.ravel()
    assert np.abs(off).max() < 1e-4
    unit = splats.quats / np.linalg.norm(splats.quats, axis=1, keepdims=True)
    assert np.abs(quats.reshape(-1, 4) / 32767 - unit).max() < 2e-5
    assert np.abs(opacities / 65535 - gaussians.opacities.numpy()).max() < 1e-5
    low, high = built.sh0
    assert np.abs(low + (high - low) * sh0 / 65535 - splats.sh0.ravel()).max() < 1e-4
    coded = (bands.reshape(banded, built.rest, 3).astype(float) - 128) / 127
    for degree, (first, end) in enumerate(((0, 3), (3, 8), (8, 15))):
        part = coded[:, first:end]
        off = built.bands[degree] * part * np.abs(part) - splats.shN[:banded, first:end]
        assert not off.size or np.abs(off).max() <= built.bands[degree] / 120


def _transforms(change: Callable[[Any], object]) -> Callable[[Path], object]:
    def forge(run: Path) -> None:
        message = json.loads((run / "transforms.json").read_text())
        change(message)
        (run / "transforms.json").write_text(json.dumps(message))

    return forge


FORGED: dict[str, tuple[Callable[[Path], object], str]] = {
    "no record": (lambda run: (run / "record.json").unlink(), "expected the folder of a run"),
    "cut PLY": (
        lambda run: (run / "point_cloud.ply").write_bytes(
            (run / "point_cloud.ply").read_bytes()[:-3]
        ),
        "the file is damaged",
    ),
    "PLY outside": (lambda run: _elsewhere(run / "point_cloud.ply"), "leads out of it"),
    "photo outside": (lambda run: _elsewhere(run / "renders/test_00_truth.png"), "leads out of it"),
    "list": (lambda run: (run / "transforms.json").write_text("[]"), "expected a JSON object"),
    "matrix": (_transforms(lambda t: t["frames"][0].update(transform_matrix=[[1]])), "4x4 numbers"),
    "size": (_transforms(lambda t: t["frames"][0].update(w=1e9)), "expected sides of"),
    "dark": (
        _transforms(lambda t: t["frames"][0].update(exposure=[1, 0, 1])),
        "an exposure of 3 positive numbers",
    ),
    "twice": (_transforms(lambda t: t["frames"].append(t["frames"][0])), "each photo once"),
    "near": (_transforms(lambda t: t.update(near_plane=-1)), "a positive near_plane"),
}


def _elsewhere(file: Path) -> None:
    away = file.parents[3] / f"away-{file.name}"
    file.rename(away)
    file.symlink_to(away)


@pytest.mark.parametrize("name", FORGED)
def test_a_forged_run_is_told_in_a_line(tmp_path: Path, name: str) -> None:
    forge, expected = FORGED[name]
    run = seen_run(tmp_path / "study")
    forge(run)
    with pytest.raises(UserError, match=re.escape(expected)) as caught:
        main([str(run), "--static", str(tmp_path / "x.html")], "fishersplat view")
    assert "\n" not in str(caught.value) and not (tmp_path / "x.html").exists()


def test_two_runs_are_told_apart_and_share_cameras(tmp_path: Path) -> None:
    runs = [read_viewed(seen_run(tmp_path, augment=augment)) for augment in ("none", "safi")]
    check_together(runs)
    data = data_of(view_page(runs))
    labels = [run["label"] for run in data["runs"]]
    assert labels == ["baseline · seed 0", "safi · seed 0"]
    assert len(data["cameras"][0]["psnr"]) == 2 and len(data["cameras"]) == 5
    twice = [runs[0], runs[0]]
    labels = [run["label"] for run in data_of(view_page(twice))["runs"]]
    assert labels[0].endswith(runs[0].folder.name)


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("RUN RUN RUN", "expected one run or two, got 3"),
        ("RUN --port 70000", "expected 0 to 65535"),
        ("RUN RUN --static", "expected a file for the page of two runs"),
        ("--static RUN", "required"),
        ("RUN --static other", "ends in .html"),
        ("nowhere", "found nothing"),
    ],
)
def test_a_wrong_command_is_told_in_a_line(tmp_path: Path, line: str, expected: str) -> None:
    run = seen_run(tmp_path)
    words = [str(run) if word == "RUN" else word for word in line.split()]
    with pytest.raises((UserError, SystemExit)) as caught:
        main(words, "fishersplat view")
    assert isinstance(caught.value, SystemExit) or expected in str(caught.value)


def test_it_writes_a_file_without_torch(tmp_path: Path) -> None:
    run = seen_run(tmp_path)
    code = (
        "import sys; from framework.command.cli import main; code = main(sys.argv[1:]);"
        "print([n for n in ('torch', 'numba', 'cv2', 'matplotlib') if n in sys.modules]);"
        "sys.exit(code)"
    )
    command = [sys.executable, "-c", code, "view", str(run), "--static"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert "view.html" in done.stdout and "[]" in done.stdout
    assert (run / "view.html").read_text(encoding="utf-8") == view_page([read_viewed(run)])


def test_it_shows_an_exported_file(tmp_path: Path) -> None:
    run = seen_run(tmp_path)
    assert export([str(run), "--compact", "--frame", "scene"], "export") == 0
    file = run / "export" / "scene.spz"
    exported, stored = read_exported(file), read_viewed(run)
    check_together([stored, exported])
    assert "12 Gaussians" in view_page([stored, exported])
    near = np.abs(exported.splats.means[:, None] - stored.splats.means[None]).sum(2).min(1)
    assert near.max() < 0.2 and exported.splats.background == stored.splats.background
    assert main([str(file), "--static"], "view") == 0 and (run / "export" / "view.html").is_file()
    other = tmp_path / "scene.spz"
    other.write_bytes(file.read_bytes())
    with pytest.raises(UserError, match=r"without record\.json"):
        main([str(other), "--static"], "view")
