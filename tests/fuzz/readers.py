"""Every reader of a file from elsewhere, with a valid example of what it reads."""

import os
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image

from framework.depth.providers import DepthFile
from framework.depth.read import load_map
from framework.errors import UserError
from framework.exports import export, render, video
from framework.exports.formats import packed
from framework.files.opened import read_bytes
from framework.metrics.lpips import load as load_lpips
from framework.records.ply import read_ply, write_ply
from framework.records.record import read_run, write_failed
from framework.records.spz_reader import read_spz
from framework.report.build import build_report
from framework.scenes.images import read_image
from framework.train.resume.checkpoint import pack, unpack
from framework.types import Gaussians, Scene
from framework.view.page import view_page
from framework.view.runs import find_run, read_viewed
from tests.built import load_scene
from tests.fuzz import commands
from tests.metrics.test_lpips import features, state_dict
from tests.record.fakes import fake_run, make_config, make_gaussians
from tests.resume.test_checkpoint import state
from tests.scenes.synthetic import write_llff, write_model, write_scene, write_table
from tests.scenes.test_blender import write as write_blender
from tests.scenes.test_dtu import write_dtu
from tests.scenes.test_transforms import BOUNDS
from tests.scenes.test_transforms import write as write_transforms
from tests.view.runs import seen_run

Step = Callable[[Path], object]


@dataclass(frozen=True)
class Reader:
    """make(folder): a valid example; files: those of it that are mutated; read(folder): raises
    `refusals` for a bad one."""

    make: Step
    files: tuple[str, ...]
    read: Step
    refusals: tuple[type[Exception], ...] = (UserError,)


def write_binary_model(folder: Path) -> None:
    """The text model of `write_model` with 10 images, as COLMAP's binaries."""
    write_model(folder, 10, [((0.3, 0.1, 4.0), range(10)), ((-0.2, 0.0, 6.0), range(10))])
    import pycolmap

    model = pycolmap.Reconstruction(str(folder))
    model.write_binary(str(folder))
    for file in folder.glob("*.txt"):
        file.unlink()


def _colmap(folder: Path) -> None:
    write_scene(folder)
    for file in (folder / "sparse" / "0").iterdir():
        file.unlink()
    write_binary_model(folder / "sparse" / "0")


def _two_degrees() -> Gaussians:
    gaussians = make_gaussians(6, 1)
    return gaussians.replace(shN=gaussians.shN[:2])


def _scene(name: str, **options: Any) -> Step:
    return lambda folder: _sensible(
        load_scene(name, {"path": str(folder), "n_views": 3, **options})
    )


def _sensible(scene: Scene) -> None:
    """What was read is a scene: numbers that mean nothing would do harm later."""
    training = scene.training
    assert 0 < training.near < training.far <= 1e9
    assert not len(training.points.xyz) or training.points.xyz.abs().max() <= 1e9
    for view in (*training.views, *scene.test):
        view.name.encode("utf-8")  # records hold it
        camera, rotation = view.camera, view.camera.viewmat[:3, :3]
        assert (rotation @ rotation.T - torch.eye(3)).abs().max() <= 1e-2
        assert rotation.det() > 0 and camera.center.abs().max() <= 1e10
        assert 0 < camera.K[0, 0] <= 1e9 and 0 < camera.K[1, 1] <= 1e9
        assert camera.K.abs().max() <= 1e9 and bool(view.image.isfinite().all())


def _named(folder: Path) -> None:
    write_llff(folder)
    (folder / "photo.line").write_bytes(b"im01.png")


def _renamed(folder: Path) -> None:
    """The scene, one photo of which is called as `photo.line` says."""
    name = os.fsdecode(read_bytes(folder / "photo.line", 1 << 20))
    photos = folder / "images_8"
    try:
        (photos / "im01.png").rename(photos / name)
    except (OSError, ValueError):
        raise UserError("no file system takes this name") from None
    try:
        _scene("llff")(folder)
    finally:
        (photos / name).rename(photos / "im01.png")


def _study(folder: Path) -> None:
    """A sound run, and two that are changed: one complete, one that failed."""
    fake_run(folder, run_name="sound")
    fake_run(folder, "safi", run_name="x")
    write_failed(folder / "runs" / "y", make_config(seed=1), ["seed=1"], "no overlap")
    (folder / "runs/y/record.json").unlink()


def _reported(folder: Path) -> None:
    """The report always lists the sound run, and each damaged one in a line."""
    path = build_report(folder).path
    message = path.read_text(encoding="utf-8")
    assert "(runs/sound/)" in message, "the sound run is missing"
    (folder / "report.html").read_text(encoding="utf-8")
    rows = [line for line in message.splitlines() if "| damaged |" in line]
    if rows:
        assert all(len(row) < 1500 for row in rows)
        raise UserError("a damaged run is listed")


def _table(folder: Path) -> None:
    """The table of a study whose runs are gone."""
    for seed in range(2):
        fake_run(folder, seed=seed)
        fake_run(folder, "safi", seed=seed)
    build_report(folder)
    shutil.rmtree(folder / "runs")


def _viewed(folder: Path) -> None:
    view_page([read_viewed(find_run(folder))], True)


def _photo(name: str, mode: str) -> Step:
    pixels = np.arange(24 * 32 * 4, dtype=np.uint32).reshape(24, 32, 4).astype(np.uint8)
    channels = {"RGB": pixels[..., :3], "L": pixels[..., 0], "RGBA": pixels}[mode]
    return lambda folder: Image.fromarray(channels).save(folder / name)


def _read(name: str) -> Step:
    return lambda folder: read_image(folder / name)


def _points(folder: Path, text: bool) -> None:
    write_transforms(folder)
    kinds = [(axis, "f4") for axis in "xyz"] + [(c, "u1") for c in ("red", "green", "blue")]
    rows = np.array([(0, 0, 4, 1, 2, 3), (0.1, 0, 5, 4, 5, 6)], dtype=kinds)
    write_table(folder / "points.ply", rows, text)


def _pack(folder: Path) -> None:
    (folder / "state.safetensors").write_bytes(pack(state(3), CLASSES, "mine", "fuzz"))


def _depth(file: str) -> Step:
    options = DepthFile(path=".", invalid="error")
    return lambda folder: load_map(folder / file, options)


def _depth_png(folder: Path) -> None:
    Image.fromarray(np.arange(768, dtype=np.uint16).reshape(24, 32)).save(folder / "a.png")


def _lpips(folder: Path) -> None:
    torch.save(state_dict("AlexNet", features("AlexNet")), folder / "weights.pth")


SHOWN = ("runs/run/transforms.json", "runs/run/point_cloud.ply")


def _classes() -> list[type]:
    from framework.train.resume.checkpoint import state_classes

    return state_classes([])


CLASSES = _classes()
MODEL = "sparse/0"
BINARY = tuple(f"{MODEL}/{stem}.bin" for stem in ("cameras", "images", "points3D"))
TEXTS = tuple(f"{MODEL}/{stem}.txt" for stem in ("cameras", "images", "points3D"))
VALUES = np.linspace(1, 2, 768, dtype=np.float32).reshape(24, 32)
READERS: dict[str, Reader] = {
    "splat ply": Reader(
        lambda f: write_ply(f / "a.ply", make_gaussians(6, 1), torch.rand(3)),
        ("a.ply",),
        lambda f: read_ply(f / "a.ply"),
    ),
    "spz": Reader(
        lambda f: (f / "a.spz").write_bytes(packed(make_gaussians(6, 1), torch.zeros(3), "spz")),
        ("a.spz",),
        lambda f: read_spz(f / "a.spz"),
    ),
    "splat ply of two degrees": Reader(
        lambda f: write_ply(f / "a.ply", _two_degrees(), torch.rand(3)),
        ("a.ply", "a_sh.npy"),
        lambda f: read_ply(f / "a.ply"),
    ),
    "colmap binary": Reader(_colmap, BINARY, _scene("colmap")),
    "colmap text": Reader(write_scene, TEXTS, _scene("colmap")),
    "llff poses": Reader(write_llff, ("poses_bounds.npy",), _scene("llff")),
    "dtu cameras": Reader(write_dtu, ("cameras.npz",), _scene("dtu", downscale=1)),
    "transforms json": Reader(
        write_transforms, ("transforms.json",), _scene("transforms", **BOUNDS)
    ),
    "blender json": Reader(
        write_blender,
        ("transforms_train.json", "transforms_test.json"),
        _scene("blender", downscale=1, split="file"),
    ),
    "points ply text": Reader(
        lambda f: _points(f, True),
        ("points.ply",),
        _scene("transforms", points="points.ply", **BOUNDS),
    ),
    "points ply binary": Reader(
        lambda f: _points(f, False),
        ("points.ply",),
        _scene("transforms", points="points.ply", **BOUNDS),
    ),
    "image png": Reader(_photo("a.png", "RGB"), ("a.png",), lambda f: read_image(f / "a.png")),
    "image jpeg": Reader(_photo("a.jpg", "RGB"), ("a.jpg",), lambda f: read_image(f / "a.jpg")),
    **{
        f"image {suffix}": Reader(
            _photo(f"a.{suffix}", "RGB"), (f"a.{suffix}",), _read(f"a.{suffix}")
        )
        for suffix in ("tif", "webp", "bmp")
    },
    "depth npy": Reader(lambda f: np.save(f / "a.npy", VALUES), ("a.npy",), _depth("a.npy")),
    "depth npz": Reader(
        lambda f: np.savez_compressed(f / "a.npz", depth=VALUES), ("a.npz",), _depth("a.npz")
    ),
    "depth png": Reader(_depth_png, ("a.png",), _depth("a.png")),
    "run record": Reader(
        lambda f: fake_run(f, run_name="run"),
        tuple(f"runs/run/{name}" for name in ("record.json", "metrics.csv", "history.csv")),
        lambda f: read_run(f / "runs" / "run"),
    ),
    "study": Reader(
        _study,
        (
            *(f"runs/x/{name}" for name in ("record.json", "metrics.csv", "history.csv")),
            *(f"runs/x/renders/test_00{kind}.png" for kind in ("", "_truth", "_error")),
            "runs/y/failed.json",
        ),
        _reported,
    ),
    "archive of runs": Reader(
        _table, ("runs.jsonl",), lambda f: build_report(f, out_dir=f / "out")
    ),
    "viewed run": Reader(
        lambda f: seen_run(f, run_name="run"),
        tuple(
            f"runs/run/{name}"
            for name in ("record.json", "transforms.json", "metrics.csv", "point_cloud.ply")
        ),
        _viewed,
    ),
    "video of a run": Reader(
        commands.small_run,
        SHOWN,
        commands.commanded(
            video.main, *("--seconds", "1", "--fps", "2", "--size", "32", "--out", "{out}/a.gif")
        ),
    ),
    "pictures of a run": Reader(
        commands.small_run,
        (*SHOWN, "runs/run/cameras.json"),
        commands.commanded(render.main, "--size", "32", "--out", "{out}"),
    ),
    "files of a run": Reader(
        commands.small_run,
        SHOWN,
        commands.commanded(
            export.main, "--format", "ply", "spz", "splat", "--frame", "upright", "--out", "{out}"
        ),
    ),
    "prepared jpeg": Reader(
        lambda f: commands.photo(f, "jpg"), ("a.jpg",), commands.prepared("a.jpg", 64)
    ),
    "prepared png": Reader(
        lambda f: commands.photo(f, "png"), ("a.png",), commands.prepared("a.png", 128)
    ),
    "photo names": Reader(_named, ("photo.line",), _renamed),
    "lpips weights": Reader(
        _lpips,
        ("weights.pth",),
        lambda f: load_lpips(f / "weights.pth"),
        (UserError, OSError),
    ),
    # its errors are caught by `Checkpoints`, which then uses the one before
    "checkpoint": Reader(
        _pack,
        ("state.safetensors",),
        lambda f: unpack(f / "state.safetensors", CLASSES),
        (ValueError, RecursionError),
    ),
}
