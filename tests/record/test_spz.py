"""The reader of SPZ files: the written values, in our axes, and one line for a damaged file."""

import gzip
import struct
from pathlib import Path

import numpy as np
import pytest
import torch

from framework.errors import UserError
from framework.exports.formats import packed
from framework.geometry import rotation_matrices
from framework.records.spz_reader import read_spz, unpacked
from tests.exports.folders import some_gaussians


@pytest.mark.parametrize("terms", [0, 3, 8, 15])
def test_the_values_come_back(tmp_path: Path, terms: int) -> None:
    gaussians = some_gaussians(terms=terms)
    (tmp_path / "a.spz").write_bytes(packed(gaussians, torch.zeros(3), "spz"))
    splats = read_spz(tmp_path / "a.spz")
    assert np.allclose(splats.means, gaussians.means, atol=1e-4)
    assert np.allclose(splats.log_scales, gaussians.log_scales, atol=0.04)
    assert np.allclose(splats.sh0, gaussians.sh0, atol=0.02)
    assert splats.shN.shape == gaussians.shN.shape
    assert np.allclose(splats.shN, gaussians.shN.clamp(-1, 127 / 128), atol=0.01)
    opacities = 1 / (1 + np.exp(-splats.opacity_logits))
    assert np.allclose(opacities, gaussians.opacities, atol=0.003)
    axes, written = map(rotation_matrices, (torch.from_numpy(splats.quats), gaussians.quats))
    assert torch.allclose((axes * written).sum(1).abs(), torch.ones(40, 3), atol=1e-3)


def header(n: int, version: int = 3, degree: int = 0) -> bytes:
    return struct.pack("<4sIIBBBB", b"NGSP", version, n, degree, 12, 0, 0)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"glTF" + header(1)[4:], "not an SPZ file"),
        (header(1, version=2) + bytes(20), "got version 2"),
        (header(1, degree=9) + bytes(20), "degree 9"),
        (header(2) + bytes(39), "cut off"),
        (header(2**32 - 1) + bytes(1000), "at most 1,073,741,824 bytes"),
    ],
)
def test_a_damaged_file_ends_in_one_line(content: bytes, message: str) -> None:
    with pytest.raises(UserError, match=message):
        unpacked(gzip.compress(content), "a.spz")


@pytest.mark.parametrize("content", [b"", b"no gzip at all"])
def test_what_is_no_gzip_ends_in_one_line(content: bytes) -> None:
    with pytest.raises(UserError, match=r"a\.spz: .*SPZ file"):
        unpacked(content, "a.spz")
