"""What other programs open: values after a round trip, axes, first view, background."""

import importlib.util
import json
from pathlib import Path

import numpy as np
import pytest
import torch

from framework.errors import UserError
from framework.exports.export import main
from framework.exports.flight import rig
from framework.exports.formats import SUFFIXES, packed
from framework.exports.opened import open_run, read_named_cameras
from framework.exports.upright import moved_camera, turned_bands, upright
from framework.kernels import rasterize
from framework.kernels.reference import sh_basis
from framework.records.ply import read_ply
from tests.exports.folders import all_around, run_folder, side_by_side, some_gaussians

BLACK = torch.zeros(3)
ODD_UP = (0.36, 0.48, 0.8)  # of a world that is not upright


def motion() -> np.ndarray:
    return upright(rig(all_around(up=ODD_UP)), 4.0)


@pytest.mark.parametrize("terms", [3, 8, 15])
def test_colours_turn_with_the_scene(terms: int) -> None:
    turn = torch.from_numpy(motion()[:3, :3])
    shN = torch.randn(5, terms, 3, generator=torch.Generator().manual_seed(0))
    directions = torch.nn.functional.normalize(torch.randn(20, 3).double(), dim=1)
    degree = {3: 1, 8: 2, 15: 3}[terms]
    before = sh_basis(directions, degree)[:, 1:] @ shN.double().permute(2, 1, 0)
    turned = turned_bands(shN, turn).double().permute(2, 1, 0)
    after = sh_basis(directions @ turn.T, degree)[:, 1:] @ turned
    assert torch.allclose(before, after, atol=1e-5)


@pytest.mark.parametrize("cameras", [all_around(up=ODD_UP), side_by_side()])
def test_upright_means_y_down_and_the_middle_at_the_origin(cameras: list) -> None:  # type: ignore[type-arg]
    moved = upright(rig(cameras), 4.0)
    stood = rig([moved_camera(camera, moved) for camera in cameras])
    assert np.allclose(stood.up, [0, -1, 0], atol=0.05)
    assert np.allclose(moved[:3] @ [0, 0, 0, 1], 0, atol=0.2)  # where all of them look


@pytest.mark.slow  # gsply compiles its own kernels each time
def test_files_hold_the_values_and_gsply_reads_them(tmp_path: Path) -> None:
    gsply = pytest.importorskip("gsply")
    gaussians = some_gaussians()
    (tmp_path / "a.spz").write_bytes(packed(gaussians, BLACK, "spz"))
    spz = gsply.read_spz(tmp_path / "a.spz")
    flipped = gaussians.means.numpy() * [1, -1, -1]  # right, up, back
    assert np.allclose(spz.means, flipped, atol=1e-3)
    assert np.allclose(spz.scales, gaussians.log_scales, atol=0.04)
    assert np.allclose(np.array(spz.sh0).reshape(-1, 3), gaussians.sh0[:, 0], atol=0.02)
    assert np.allclose(spz.shN[:, 1], -gaussians.shN[:, 1], atol=0.01)  # that of z

    (tmp_path / "a.compressed.ply").write_bytes(packed(gaussians, BLACK, "compressed-ply"))
    small = gsply.plyread(tmp_path / "a.compressed.ply")
    order = np.abs(small.means[:, None] - gaussians.means.numpy()[None]).sum(2).argmin(1)
    assert sorted(order) == list(range(len(gaussians)))
    assert np.allclose(small.means, gaussians.means[order], atol=2e-3)


def test_a_splat_is_32_bytes_the_largest_first() -> None:
    gaussians = some_gaussians()
    rows = np.frombuffer(packed(gaussians, BLACK, "splat"), np.uint8).reshape(-1, 32)
    assert len(rows) == len(gaussians)
    means = rows[:, :12].copy().view("<f4")
    cover = (gaussians.scales.prod(dim=1) * gaussians.opacities).numpy()
    first = int(np.abs(gaussians.means.numpy() - means[0]).sum(axis=1).argmin())
    assert cover[first] == cover.max()
    assert abs(int(rows[0, 27]) - 255 * float(gaussians.opacities[first])) <= 1


def test_sog_needs_its_writer(monkeypatch: pytest.MonkeyPatch) -> None:
    def absent(name: str) -> None:
        return None

    monkeypatch.setattr(importlib.util, "find_spec", absent)
    with pytest.raises(UserError, match="pip install 'fishersplat\\[sog\\]'"):
        packed(some_gaussians(), BLACK, "sog")


def test_the_command_writes_cameras_and_the_first_view(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = run_folder(tmp_path / "run", all_around(up=ODD_UP))
    kinds = [kind for kind in SUFFIXES if kind != "sog"]
    assert main([str(run), "--format", *kinds], "export") == 0
    assert "40 Gaussians" in capsys.readouterr().out
    names = {f"scene{SUFFIXES[kind]}" for kind in kinds}
    files = {file.name for file in (run / "export").iterdir()}
    assert files == names | {"cameras.json", "transforms.json", "settings.json"}

    message = json.loads((run / "export" / "settings.json").read_text())
    assert message["background"]["color"] == pytest.approx([0.25, 0.5, 0.75])
    first = np.array(message["camera"]["position"]) * [-1, -1, 1]
    inputs = read_named_cameras(run / "export" / "cameras.json")
    assert min(np.linalg.norm(one.camera.center.numpy() - first) for one in inputs) < 1e-6

    opened = open_run(run)
    read, _ = read_ply(run / "export" / "scene.ply")
    before = rasterize(opened.gaussians, opened.cameras[2].camera).rgb
    assert float((rasterize(read, inputs[2].camera).rgb - before).abs().max()) < 2e-3


def test_the_runs_own_files_are_not_written_over(tmp_path: Path) -> None:
    run = run_folder(tmp_path / "run", side_by_side())
    with pytest.raises(UserError, match="another folder than the run's"):
        main([str(run), "--out", str(run)], "export")
    other = tmp_path / "other"
    other.mkdir()
    (other / "record.json").touch()
    with pytest.raises(UserError, match="another folder than the run's"):
        main([str(run), "--out", str(other)], "export")


def test_a_users_cameras_are_not_written_over(tmp_path: Path) -> None:
    run, mine = run_folder(tmp_path / "run", side_by_side()), tmp_path / "mine"
    mine.mkdir()
    (mine / "transforms.json").write_text("poses")
    with pytest.raises(UserError, match=r"whose transforms\.json would be"):
        main([str(run), "--out", str(mine)], "export")
    assert (mine / "transforms.json").read_text() == "poses"
    assert [main([str(run), "--out", str(tmp_path / "new")], "export") for _ in range(2)] == [0, 0]


def test_all_are_those_that_can_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("framework.exports.export.can_write", lambda kind: kind != "sog")
    run = run_folder(tmp_path / "run", side_by_side())
    assert main([str(run), "--format", "all"], "export") == 0
    assert "export: without sog; pip install 'fishersplat[sog]'" in capsys.readouterr().out
    written = {file.name for file in (run / "export").iterdir()}
    assert "scene.splat" in written and "settings.json" in written and "scene.sog" not in written
