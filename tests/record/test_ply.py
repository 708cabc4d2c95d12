"""The PLY layout: exact round trips, readable elsewhere, channel-major f_rest, damaged files."""

from pathlib import Path

import numpy as np
import pytest
import torch

from framework.errors import UserError
from framework.files.ply import read_commented
from framework.records.ply import read_ply, write_ply
from tests.record.fakes import make_gaussians


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("n", [0, 1, 7])
def test_round_trip_is_exact(tmp_path: Path, degree: int, n: int) -> None:
    gaussians = make_gaussians(n, degree)
    background = torch.tensor([0.1, 1 / 3, 0.7])
    size = write_ply(tmp_path / "a.ply", gaussians, background)
    assert size == (tmp_path / "a.ply").stat().st_size
    read, read_background = read_ply(tmp_path / "a.ply")
    assert read_background is not None and torch.equal(read_background, background)
    for (name, a), (_, b) in zip(gaussians.items(), read.items(), strict=True):
        assert torch.equal(a, b), name


def test_another_reader_reads_the_layout(tmp_path: Path) -> None:
    gsply = pytest.importorskip("gsply")
    gaussians = make_gaussians(5, 2)
    write_ply(tmp_path / "a.ply", gaussians, torch.tensor([0.0, 0.5, 1.0]))
    read = gsply.plyread(tmp_path / "a.ply")
    np.testing.assert_array_equal(read.means, gaussians.means)
    np.testing.assert_array_equal(read.quats, gaussians.quats)
    np.testing.assert_array_equal(read.scales, gaussians.log_scales)
    np.testing.assert_array_equal(read.opacities.ravel(), gaussians.opacity_logits)
    np.testing.assert_array_equal(read.sh0, gaussians.sh0[:, 0])
    np.testing.assert_array_equal(read.shN, gaussians.shN)


def test_the_layout_is_the_reference_s(tmp_path: Path) -> None:
    gaussians = make_gaussians(5, 2)
    write_ply(tmp_path / "a.ply", gaussians, torch.tensor([0.0, 0.5, 1.0]))
    head = (tmp_path / "a.ply").read_bytes().split(b"end_header\n")[0].decode()
    assert "comment background 0.0 0.5 1.0" in head and head.count("element ") == 1
    vertex, _ = read_commented(tmp_path / "a.ply")
    names = list(vertex.dtype.names or ())
    assert names[:9] == ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"]
    assert names[9:33] == [f"f_rest_{i}" for i in range(24)]
    scales, rotations = [f"scale_{i}" for i in range(3)], [f"rot_{i}" for i in range(4)]
    assert names[33:] == ["opacity", *scales, *rotations]
    for coefficient in range(8):
        for channel in range(3):
            np.testing.assert_array_equal(
                vertex[f"f_rest_{channel * 8 + coefficient}"],
                gaussians.shN[:, coefficient, channel],
            )


@pytest.mark.parametrize(
    ("bands", "message"),
    [
        (None, "found none"),
        (np.zeros((2, 3, 3), "<f4"), None),
        (np.zeros((3, 3, 3), "<f4"), r"a_sh.npy: .* shape \[2, 3, 8 or 15, 3\], got \[3, 3, 3\]"),
        (np.full((2, 3, 3), np.nan, "<f4"), "finite"),
        (np.array([object()]), "a_sh.npy"),
    ],
)
def test_damaged_bands_end_in_one_line(tmp_path: Path, bands, message: str | None) -> None:  # type: ignore[no-untyped-def]
    gaussians, path = make_gaussians(5, 1), tmp_path / "a.ply"
    write_ply(path, gaussians.replace(shN=gaussians.shN[:2]), torch.zeros(3))
    if bands is None:
        (tmp_path / "a_sh.npy").unlink()
    else:
        np.save(tmp_path / "a_sh.npy", bands, allow_pickle=True)
    if message is None:
        assert len(read_ply(path)[0].shN) == 2
        return
    with pytest.raises(UserError, match=message) as caught:
        read_ply(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda b: b[:-3], "the file is damaged"),
        (lambda b: b.replace(b"vertex 4", b"vertex 999999999999"), "the file is damaged"),
        (lambda b: b.replace(b"binary_little_endian", b"ascii"), "got a damaged one"),
        (lambda b: b.replace(b"property float opacity", b"property float opaqueness"), "opacity"),
        (lambda b: b.replace(b"float opacity", b"double opacity"), "the file is damaged"),
        (lambda b: b.replace(b"property float f_rest_8\n", b""), "got 8"),
        (lambda b: b.replace(b"background 0.0 0.0", b"background a 0.0"), "three finite numbers"),
        (lambda b: b.replace(b"rot_3", b"rot_2"), "each property once"),
        (lambda b: b.replace(b"vertex 4", b"vertex -4"), "'element NAME COUNT'"),
        (lambda b: b[:60], "no PLY file"),
        (lambda b: b"", "no PLY file"),
        (lambda b: b"\xff" * 200_000, "no PLY file"),
    ],
)
def test_damaged_files_end_in_one_line(tmp_path: Path, change, message: str) -> None:  # type: ignore[no-untyped-def]
    path = tmp_path / "a.ply"
    write_ply(path, make_gaussians(4, 1), torch.zeros(3))
    path.write_bytes(change(path.read_bytes()))
    with pytest.raises(UserError, match=message) as caught:
        read_ply(path)
    assert "\n" not in str(caught.value)
