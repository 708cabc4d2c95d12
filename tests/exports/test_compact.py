"""`fishersplat export --compact`: smaller than SPZ, and no worse than it says."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from PIL import Image

from framework.errors import UserError
from framework.exports.compact import LIMIT_DB, compact, mean_psnr, read_photos
from framework.exports.export import main
from framework.exports.formats import packed
from framework.exports.opened import OpenedRun, open_run
from framework.metrics.evaluate import quantise
from framework.types import Camera, Gaussians
from tests.exports.folders import all_around, run_folder, side_by_side, some_gaussians


def photographed(folder: Path, gaussians: Gaussians, cameras: list[Camera]) -> OpenedRun:
    """A run with photos that differ from its renders by some noise."""
    run = open_run(run_folder(folder, cameras, gaussians))
    random = torch.Generator().manual_seed(0)
    for name in ("photos", "renders"):
        (folder / name).mkdir()
    for k, camera in enumerate(cameras):
        image = run.render(camera).rgb
        noisy = (image + 0.05 * torch.randn(image.shape, generator=random)).clamp(0, 1)
        file = f"photos/{k}.jpg.jpg" if k else "renders/0.jpg_truth.png"
        Image.fromarray(quantise(noisy)).save(folder / file.replace("/", "/a_"))
    return run


def small(n: int = 400) -> Gaussians:
    return some_gaussians(n).replace(log_scales=some_gaussians(n).log_scales - 0.7)


def test_it_is_smaller_and_loses_no_more_than_the_limit(tmp_path: Path) -> None:
    run = photographed(tmp_path / "run", small(), side_by_side())
    train, test = read_photos(run.folder)
    assert (len(train), len(test)) == (3, 1)
    result = compact(run, train)
    assert len(result.content) < 0.9 * len(packed(run.gaussians, run.background, "spz"))
    before, after = (mean_psnr(run, g, train) for g in (run.gaussians, result.gaussians))
    assert before - after <= LIMIT_DB


def test_bands_that_show_nothing_are_left_out(tmp_path: Path) -> None:
    gaussians = small()
    faint = torch.cat([2 * gaussians.shN[:, :3], 1e-3 * gaussians.shN[:, 3:]], dim=1)
    run = photographed(tmp_path / "run", gaussians.replace(shN=faint), all_around())
    result = compact(run, read_photos(run.folder)[0])
    assert result.precision.degree == result.gaussians.sh_degree == 1
    assert result.precision.bits < 8


def test_the_mean_colour_of_lost_bands_is_kept(tmp_path: Path) -> None:
    """Seen from one place, bands are a colour."""
    run = photographed(tmp_path / "run", small(), side_by_side())
    one = replace(run, cameras=run.cameras[:1])
    result = compact(one, read_photos(run.folder)[0][:1])
    assert result.precision.degree == 0


def test_the_command_says_what_it_loses(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = photographed(tmp_path / "run", small(), side_by_side())
    assert main([str(run.folder), "--compact"], "export") == 0
    out = capsys.readouterr().out
    assert "scene.spz" in out and " kB, PSNR" in out and "1 test photo," in out
    assert (run.folder / "export" / "scene.spz").is_file()
    with pytest.raises(UserError, match="--compact: expected no --format"):
        main([str(run.folder), "--compact", "--format", "spz"], "export")


def test_a_run_without_photos_is_written_all_the_same(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = run_folder(tmp_path / "run", side_by_side())
    assert main([str(run), "--compact"], "export") == 0
    assert "loss not measured" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"train_filenames": 3}, "names of photos"),
        ({"train_filenames": ["a/0.jpg", "other"]}, "expected a camera of 'other'"),
        ({"frames": {"exposure": [1, 2]}}, "an exposure of 3 positive numbers"),
        ({"frames": {"w": 7}}, "expected 7x36 pixels"),
    ],
)
def test_a_damaged_list_of_photos_ends_in_one_line(
    tmp_path: Path, change: dict[str, Any], message: str
) -> None:
    folder = photographed(tmp_path / "run", small(), side_by_side()).folder
    content = json.loads((folder / "transforms.json").read_text())
    for frame in content["frames"]:
        frame.update(change.get("frames", {}))
    content.update({key: value for key, value in change.items() if key != "frames"})
    (folder / "transforms.json").write_text(json.dumps(content))
    with pytest.raises(UserError, match=message):
        read_photos(folder)
