"""The SH basis against scipy's complex spherical harmonics."""

import math

import numpy as np
import torch
from scipy.special import sph_harm_y

from framework.compute.rng import stream
from framework.kernels.reference import sh_basis


def test_basis_equals_scipy() -> None:
    """Real harmonics with the Condon-Shortley phase: sqrt(2) Im Y_l^|m| for m < 0, sqrt(2) Re Y_l^m
    for m > 0."""
    directions = stream(0, "test-directions").standard_normal((50, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    x, y, z = directions.T
    polar, azimuth = np.arccos(z), np.arctan2(y, x)
    columns = []
    for degree in range(4):
        for m in range(-degree, degree + 1):
            value = sph_harm_y(degree, abs(m), polar, azimuth)
            part = value.imag if m < 0 else value.real
            columns.append(part * (1.0 if m == 0 else math.sqrt(2)))
    basis = sh_basis(torch.from_numpy(directions), 3)
    np.testing.assert_allclose(basis.numpy(), np.stack(columns, 1), atol=1e-13)
