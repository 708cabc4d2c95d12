"""The PLY layout: exact round trips, readable by plyfile, channel-major f_rest, damaged files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from plyfile import PlyData

from framework.errors import UserError
from framework.ply import read_ply, write_ply
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


def test_plyfile_reads_the_layout(tmp_path: Path) -> None:
    gaussians = make_gaussians(5, 2)
    write_ply(tmp_path / "a.ply", gaussians, torch.tensor([0.0, 0.5, 1.0]))
    data = PlyData.read(str(tmp_path / "a.ply"))
    assert "background 0.0 0.5 1.0" in data.comments
    assert [element.name for element in data] == ["vertex"]
    vertex = data["vertex"]
    names = [p.name for p in vertex.properties]
    assert names[:9] == ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"]
    assert names[9:33] == [f"f_rest_{i}" for i in range(24)]
    assert names[33:] == [
        "opacity",
        *(f"scale_{i}" for i in range(3)),
        *(f"rot_{i}" for i in range(4)),
    ]
    np.testing.assert_array_equal(vertex["z"], gaussians.means[:, 2])
    np.testing.assert_array_equal(vertex["rot_0"], gaussians.quats[:, 0])
    for coefficient in range(8):
        for channel in range(3):
            np.testing.assert_array_equal(
                vertex[f"f_rest_{channel * 8 + coefficient}"],
                gaussians.shN[:, coefficient, channel],
            )


@pytest.mark.parametrize(("banded", "elements"), [(0, 1), (2, 2), (5, 1)])
def test_bands_of_the_first_alone_are_an_element_of_their_own(
    tmp_path: Path, banded: int, elements: int
) -> None:
    gaussians = make_gaussians(5, 2)
    gaussians = gaussians.replace(shN=gaussians.shN[:banded])
    size = write_ply(tmp_path / "a.ply", gaussians, torch.zeros(3))
    data = PlyData.read(str(tmp_path / "a.ply"))
    assert [element.name for element in data] == ["vertex", "sh"][:elements]
    if elements == 2:
        assert len(data["sh"]) == banded and "f_rest_0" not in data["vertex"]
        np.testing.assert_array_equal(data["sh"]["f_rest_9"], gaussians.shN[:, 1, 1])
    assert size - 4 * (5 * 17 + banded * 24) < 1500  # the header
    read, _ = read_ply(tmp_path / "a.ply")
    assert torch.equal(read.shN, gaussians.shN) or (banded == 0 and read.sh_degree == 0)
    assert torch.equal(read.means, gaussians.means) and torch.equal(read.quats, gaussians.quats)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda b: b.replace(b"element sh 2", b"element sh 5"), "1 to 4 rows of 'sh'"),
        (lambda b: b.replace(b"element sh 2", b"element sh 3"), "bytes for 5 vertices"),
        (lambda b: b.replace(b"element sh 2", b"element faces 2"), "element 'vertex'"),
        (lambda b: b.replace(b"f_rest_8", b"f_rest_9"), "f_rest_8"),
        (lambda b: b[:-4] + b"\0\0\xc0\x7f", "NaN or infinity in 1 vertices"),
    ],
)
def test_damaged_bands_end_in_one_line(tmp_path: Path, change, message: str) -> None:  # type: ignore[no-untyped-def]
    gaussians, path = make_gaussians(5, 1), tmp_path / "a.ply"
    write_ply(path, gaussians.replace(shN=gaussians.shN[:2]), torch.zeros(3))
    path.write_bytes(change(path.read_bytes()))
    with pytest.raises(UserError, match=message) as caught:
        read_ply(path)
    assert "\n" not in str(caught.value)


def test_a_file_of_another_trainer_without_background(tmp_path: Path) -> None:
    write_ply(tmp_path / "a.ply", make_gaussians(3, 0), torch.zeros(3))
    content = (tmp_path / "a.ply").read_bytes().replace(b"comment background 0.0 0.0 0.0\n", b"")
    (tmp_path / "b.ply").write_bytes(content)
    assert read_ply(tmp_path / "b.ply")[1] is None


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda b: b[:-3], "bytes for 4 vertices"),
        (lambda b: b + b"\0", "bytes for 4 vertices"),
        (lambda b: b.replace(b"vertex 4", b"vertex 999999999999"), "999999999999 vertices"),
        (lambda b: b.replace(b"binary_little_endian", b"ascii"), "binary_little_endian"),
        (lambda b: b.replace(b"property float opacity", b"property float opaqueness"), "opacity"),
        (lambda b: b.replace(b"float opacity", b"double opacity"), "float properties"),
        (lambda b: b.replace(b"property float f_rest_8\n", b""), "got 8"),
        (lambda b: b.replace(b"background 0.0 0.0", b"background a 0.0"), "three finite numbers"),
        (lambda b: b.replace(b"rot_3", b"rot_2"), "distinct"),
        (lambda b: b.replace(b"vertex 4", b"vertex -4"), "element 'vertex'"),
        (lambda b: b[:60], "not a PLY"),
        (lambda b: b"", "not a PLY"),
        (lambda b: b"\xff" * 200_000, "not a PLY"),
    ],
)
def test_damaged_files_end_in_one_line(tmp_path: Path, change, message: str) -> None:  # type: ignore[no-untyped-def]
    path = tmp_path / "a.ply"
    write_ply(path, make_gaussians(4, 1), torch.zeros(3))
    path.write_bytes(change(path.read_bytes()))
    with pytest.raises(UserError, match=message) as caught:
        read_ply(path)
    assert "\n" not in str(caught.value)


def test_a_missing_file(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="found none"):
        read_ply(tmp_path / "none.ply")
