"""`fishersplat video` and `render`: what they write, and what they say to bad input."""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image, ImageSequence

from framework.command.cli import main as command
from framework.errors import UserError
from framework.exports import render, video
from framework.exports.opened import open_run, read_named_cameras
from framework.metrics.evaluate import quantise
from tests.exports.folders import HEIGHT, WIDTH, run_folder, side_by_side


@pytest.fixture
def run(tmp_path: Path) -> Path:
    return run_folder(tmp_path / "run", side_by_side())


@pytest.mark.parametrize("suffix", [".webp", ".gif"])
def test_an_animated_picture_has_the_frames(run: Path, suffix: str) -> None:
    out = run / f"v{suffix}"
    line = [str(run), "--seconds", "0.5", "--fps", "24", "--out", str(out), "--show", "both"]
    assert video.main(line, "video") == 0
    with Image.open(out) as moving:
        assert moving.size == (2 * WIDTH, HEIGHT)
        lengths = []
        for frame in ImageSequence.Iterator(moving):
            frame.load()  # before, the length of a WebP's frame is not read
            lengths.append(frame.info["duration"])
        assert len(lengths) == 12 and sum(lengths) == 500  # ms, though none has 1000 / 24


def test_mp4_is_h264(run: Path) -> None:
    av = pytest.importorskip("av", reason="no dependency: its wheels hold GPL libraries")
    assert video.main([str(run), "--seconds", "0.5", "--out", str(run / "a.mp4")], "video") == 0
    with av.open(str(run / "a.mp4")) as container:
        assert container.streams.video[0].codec_context.name == "h264"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--fps", "0"], "--fps: expected 1 to 60"),
        (["--seconds", "599", "--size", "4096"], "change --seconds, --fps or --size"),
        (["--out", "a.avi"], "rename it"),
        (["--out", "a.gif", "--fps", "60"], "--fps: expected at most 50 for a GIF"),
    ],
)
def test_bad_options_end_in_one_line(run: Path, words: list[str], message: str) -> None:
    with pytest.raises(UserError, match=message):
        video.main([str(run), *words], "video")


def test_pictures_are_the_renders_of_the_run(run: Path) -> None:
    for name in ("cameras.json", "transforms.json"):
        out = run / name.replace(".json", "")
        assert render.main([str(run), "--cameras", str(run / name), "--out", str(out)], "r") == 0
        opened = open_run(run)
        for inputs in read_named_cameras(run / name):
            picture = np.asarray(Image.open(out / f"{Path(inputs.name).stem}.png"))
            assert np.array_equal(picture, quantise(opened.render(inputs.camera).rgb))


def test_a_run_s_own_pictures_are_not_written_over(run: Path) -> None:
    line = [str(run), "--cameras", str(run / "cameras.json"), "--out"]
    (run / "record.json").touch()
    for name in ("renders", "photos"):
        with pytest.raises(UserError, match="--out: expected a folder for new pictures"):
            render.main([*line, str(run / name)], "render")


def test_a_users_photos_are_not_written_over(run: Path, tmp_path: Path) -> None:
    mine = tmp_path / "mine"
    line = [str(run), "--cameras", str(run / "cameras.json"), "--out", str(mine)]
    assert render.main(line, "render") == render.main(line, "render") == 0
    photo = sorted(mine.glob("*.png"))[-1]
    Image.new("RGB", (4, 4)).save(photo)
    before = photo.read_bytes()
    with pytest.raises(UserError, match=f"one with {photo}, which fishersplat render did not"):
        render.main(line, "render")
    assert photo.read_bytes() == before


GOOD = {
    "id": 0,
    "img_name": "a",
    "width": 8,
    "height": 6,
    "position": [0, 0, 0],
    "rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    "fx": 8.0,
    "fy": 8.0,
}


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ([], "expected cameras"),
        ([{**GOOD, "position": [0, 0]}], "camera 0: expected position, 3 numbers"),
        ([{**GOOD, "rotation": [[2, 0, 0], [0, 1, 0], [0, 0, 1]]}], "orthonormal camera axes"),
        ([{**GOOD, "fx": -1}], "positive focal lengths"),
        ([{**GOOD, "width": 10**9}], "expected sides"),
        ({"frames": [{"file_path": "a", "transform_matrix": np.eye(4).tolist()}]}, "w and h"),
    ],
)
def test_cameras_that_are_none_end_in_one_line(
    tmp_path: Path, content: object, message: str
) -> None:
    file = tmp_path / "cameras.json"
    file.write_text(json.dumps(content))
    with pytest.raises(UserError, match=message):
        read_named_cameras(file)


@pytest.mark.parametrize("name", ["video", "render", "export"])
def test_a_folder_that_is_no_run_ends_in_one_line(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cameras = tmp_path / "cameras.json"
    cameras.write_text(json.dumps([GOOD]))
    more = ["--cameras", str(cameras)] if name == "render" else []
    assert command([name, str(tmp_path), *more]) == 2
    assert "expected the folder of a finished run" in capsys.readouterr().err


def test_a_study_has_a_small_video_of_each_method(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "runs").mkdir()
    records: dict[Path, SimpleNamespace] = {}
    for name, method, seed in (("a1", "a", 1), ("a0", "a", 0), ("b0", "b", 0), ("bad", "c", 0)):
        folder = run_folder(tmp_path / "runs" / name, side_by_side(2))
        (folder / "record.json").write_text("{}")
        records[folder / "record.json"] = SimpleNamespace(
            status="failed" if name == "bad" else "complete",
            scene=None,
            seed=seed,
            config={"reg": method, "seed": seed},
        )
    monkeypatch.setattr("framework.exports.video.read_record", records.__getitem__)
    monkeypatch.setattr("framework.exports.movie.has_h264", lambda: False)
    (tmp_path / "runs" / "b0" / "video.gif").write_bytes(b"")
    line = [str(tmp_path), "--seconds", "0.2", "--size", "32"]
    assert video.main(line, "video") == 0
    built = sorted(file.relative_to(tmp_path).as_posix() for file in tmp_path.rglob("video.webm"))
    assert built == ["runs/a0/video.webm"] and "b0/video.gif exists" in capsys.readouterr().out
    with pytest.raises(UserError, match="--out: expected none with a study"):
        video.main([*line, "--out", "a.webm"], "video")


def test_pictures_can_be_of_another_size_and_of_depth(run: Path) -> None:
    line = [str(run), "--cameras", str(run / "cameras.json"), "--size", "24", "--show", "depth"]
    assert render.main(line, "render") == 0
    with Image.open(run / "pictures" / "0.png") as picture:
        assert picture.size == (24, 18)
