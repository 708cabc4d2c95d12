"""Files from elsewhere: no code, no path out of their folder, no memory beyond the limits."""

import ast
import io
import pickle
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from framework.command.config.schema import ROOT
from framework.depth.read import find_file
from framework.errors import UserError
from framework.files import limits
from framework.files.archives import open_zip
from framework.files.arrays import read_npy, read_npz
from framework.files.ply import read_commented
from framework.metrics.lpips import load as load_lpips
from framework.records.ply import read_ply
from framework.records.record import read_run
from framework.scenes.images import list_images, read_image
from tests.built import load_scene
from tests.metrics.test_lpips import features, state_dict
from tests.record.fakes import fake_run
from tests.scenes.synthetic import write_llff, write_scene
from tests.scenes.test_transforms import write as write_transforms

SOURCES = [*(ROOT / "framework").rglob("*.py"), *(ROOT / "plugins").rglob("*.py")]
CODE = {"eval", "exec", "compile", "__import__"}
PICKLERS = {"pickle", "cPickle", "dill", "cloudpickle", "shelve", "marshal", "joblib"}


class Mkdir:
    """Unpickled, it would make the folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def __reduce__(self) -> tuple[Callable[..., object], tuple[Path]]:
        return Path.mkdir, (self.folder,)


def test_no_source_unpickles_or_evaluates() -> None:
    nodes = [(p, n) for p in SOURCES for n in ast.walk(ast.parse(p.read_text(encoding="utf-8")))]
    for path, node in nodes:
        if isinstance(node, ast.Import | ast.ImportFrom):
            names = [a.name for a in node.names] + [getattr(node, "module", None) or ""]
            actual = {name.partition(".")[0] for name in names} & PICKLERS
            # joblib is only configured; LPIPS weights are restricted to arrays
            assert (path.name, *actual) in {
                (path.name,),
                ("supported.py", "joblib"),
                ("lpips_weights.py", "pickle"),
            }
        if not isinstance(node, ast.Call):
            continue
        called = ast.unparse(node.func)
        keywords = {k.arg: ast.unparse(k.value) for k in node.keywords}
        assert called not in CODE, path
        if called == "np.load":
            assert keywords.get("allow_pickle") == "False"
        if called == "torch.load":
            assert keywords.get("weights_only") == "True"


def test_pickles_in_arrays_and_weights_are_refused(tmp_path: Path) -> None:
    canary = tmp_path / "canary"
    np.save(tmp_path / "a.npy", np.array([Mkdir(canary)], dtype=object), allow_pickle=True)
    with pytest.raises(UserError, match="expected numbers, got type object"):
        read_npy(tmp_path / "a.npy")
    np.savez(tmp_path / "a.npz", depth=np.array([Mkdir(canary)], dtype=object))
    with pytest.raises(UserError, match="expected numbers, got type object"):
        read_npz(tmp_path / "a.npz", ["depth"])
    (tmp_path / "raw.pth").write_bytes(pickle.dumps(Mkdir(canary)))
    torch.save({"net": Mkdir(canary)}, tmp_path / "zip.pth")
    for name in ("raw.pth", "zip.pth"):
        with pytest.raises(UserError, match="got a damaged one"):
            load_lpips(tmp_path / name)
    assert not canary.exists()


def _png(width: int, height: int) -> bytes:
    def chunk(kind: bytes, body: bytes) -> bytes:
        return (
            struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
        )

    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    packed = zlib.compress(bytes(min((width + 1) * height, 1 << 20)))
    return (
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", packed) + chunk(b"IEND", b"")
    )


@pytest.mark.parametrize(("width", "height"), [(13_000, 13_000), (10_000, 5_001), (1, 70_000)])
def test_image_bombs_are_refused_by_their_header(tmp_path: Path, width: int, height: int) -> None:
    (tmp_path / "a.png").write_bytes(_png(width, height))
    with pytest.raises(UserError, match=f"got {width}x{height}; resize it"):
        read_image(tmp_path / "a.png")


def _npy_header(shape: object) -> bytes:
    text = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}}}\n".encode()
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text


@pytest.mark.parametrize(
    "shape", [(10**12,), (2**62, 4), (-1,), (1.5,), "(" * 90 + ")" * 90, "-" * 900 + "1"]
)
def test_array_headers_that_promise_too_much(tmp_path: Path, shape: object) -> None:
    (tmp_path / "a.npy").write_bytes(_npy_header(shape) + bytes(64))
    with pytest.raises(UserError, match=r"a\.npy: expected"):
        read_npy(tmp_path / "a.npy")


def test_zip_bombs_are_refused_before_they_are_unpacked(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "a.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        for number in range(5):
            archive.writestr(f"{number}.npy", bytes(4 * limits.MIB))
    with pytest.raises(UserError, match=r"at most 9,000,000 bytes when unpacked, got 20,971,520"):
        read_npz(tmp_path / "a.npz", ["0"], most_bytes=9_000_000)
    assert (tmp_path / "a.npz").stat().st_size < limits.MIB


def test_archives_of_very_many_members_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("framework.files.archives.CONTENTS_BYTES", 10_000)
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        for number in range(300):
            archive.writestr(f"{number}", b"")
    with pytest.raises(UserError, match="table of contents of at most 10,000 bytes, got"):
        open_zip(tmp_path / "a.zip", limits.ARRAY_BYTES)


def test_weights_that_are_views_of_little_data(tmp_path: Path) -> None:
    torch.save({"a": torch.zeros(1).expand(10**6, 10**6)}, tmp_path / "w.pth")
    with pytest.raises(UserError, match="tensors of at most 536,870,912 bytes"):
        load_lpips(tmp_path / "w.pth")
    state = state_dict("VGG-16", features("VGG-16"))
    state["net.slice1.0.weight"] = torch.zeros(1, 3, 1, 1).expand(10**6, 3, 3, 3)
    torch.save(state, tmp_path / "w.pth")
    with pytest.raises(UserError, match=r"should have the shape \(16, 3, 3, 3\)"):
        load_lpips(tmp_path / "w.pth")


@pytest.mark.parametrize("count", ["1000000000000", "9" * 5000, "-1"])
def test_ply_counts_are_compared_with_the_file(tmp_path: Path, count: str) -> None:
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {count}\n"
    (tmp_path / "a.ply").write_text(f"{head}property float x\nend_header\n")
    for read in (read_ply, read_commented):
        with pytest.raises(UserError, match=r"a\.ply: expected"):
            read(tmp_path / "a.ply")


@pytest.mark.parametrize("name", ["../private.png", "/etc/hostname", "sub/../../private.png"])
def test_names_that_lead_out_of_the_scene(tmp_path: Path, name: str) -> None:
    Image.new("RGB", (40, 30)).save(tmp_path / "private.png")
    scene = write_scene(tmp_path / "scene")
    images = scene / "sparse" / "0" / "images.txt"
    images.write_text(images.read_text().replace("im01.png", f"../{name}"))
    with pytest.raises(UserError, match="expected names inside this folder"):
        load_scene("colmap", {"path": str(scene), "n_views": 3})
    other = write_transforms(
        tmp_path / "other", lambda data: data["frames"][1].update(file_path=name)
    )
    with pytest.raises(UserError, match="expected names inside this folder"):
        load_scene("transforms", {"path": str(other), "n_views": 3, "near": 1.0, "far": 9.0})
    with pytest.raises(UserError, match="expected names inside this folder"):
        load_scene("colmap", {"path": str(scene), "images": name})


def test_links_out_of_the_scene(tmp_path: Path) -> None:
    Image.new("RGB", (40, 30)).save(tmp_path / "private.png")
    scene = write_llff(tmp_path / "scene")
    photo = scene / "images_8" / "im01.png"
    photo.unlink()
    photo.symlink_to(tmp_path / "private.png")
    with pytest.raises(UserError, match=r"got 'im01\.png', which leads out of it"):
        load_scene("llff", {"path": str(scene)})
    photo.unlink()
    photo.symlink_to(photo)  # in a circle
    with pytest.raises(UserError, match=r"im01\.png"):
        load_scene("llff", {"path": str(scene)})
    photo.unlink()
    photo.symlink_to(scene / "images_8" / "im02.png")  # inside: the user's own affair
    (tmp_path / "link").symlink_to(scene)
    assert len(list_images(tmp_path / "link" / "images_8")) == 10


def test_links_out_of_the_depth_folder(tmp_path: Path) -> None:
    maps = tmp_path / "maps"
    maps.mkdir()
    np.save(tmp_path / "private.npy", np.ones((4, 4)))
    (maps / "a.npy").symlink_to(tmp_path / "private.npy")
    with pytest.raises(UserError, match=r"got 'a\.npy', which leads out of it"):
        find_file(maps, "a.png")
    (maps / "b.npy").symlink_to(maps / "c.npy")
    np.save(maps / "c.npy", np.ones((4, 4)))
    assert find_file(maps, "b.png") == maps / "b.npy"


@pytest.mark.parametrize("stem", ["../../../private", "/etc/x", "a/b", "..", "a\0b", "x" * 300])
def test_the_report_opens_no_file_outside_its_run(tmp_path: Path, stem: str) -> None:
    run_dir = fake_run(tmp_path)
    table = run_dir / "metrics.csv"
    text = table.read_text().replace("test_00", stem)
    assert text != table.read_text()
    table.write_text(text)
    with pytest.raises(UserError, match=r"expected metrics\.csv .* got a damaged one"):
        read_run(run_dir)


def test_a_message_brings_no_control_characters_along(tmp_path: Path) -> None:
    (tmp_path / "a.ply").write_bytes(b"ply\nformat \x1b]0;owned\x07\nend_header\n")
    with pytest.raises(UserError) as caught:
        read_ply(tmp_path / "a.ply")
    assert str(caught.value).isprintable()
    assert io.StringIO(str(caught.value)).readline() == str(caught.value)
