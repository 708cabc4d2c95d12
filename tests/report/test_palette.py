"""Colours stay apart in greyscale and for the colour-blind."""

import itertools

import numpy as np
import pytest

from framework.report.figures.palette import DARK, LIGHT

# Machado, Oliveira and Fernandes (2009), severity 1, on linear RGB
DEFICIENCIES = {
    "protan": [[0.152, 1.053, -0.205], [0.115, 0.786, 0.099], [-0.004, -0.048, 1.052]],
    "deutan": [[0.367, 0.861, -0.228], [0.280, 0.673, 0.047], [-0.012, 0.043, 0.969]],
    "tritan": [[1.256, -0.077, -0.179], [-0.078, 0.931, 0.148], [0.005, 0.691, 0.304]],
}


def luma(color: str) -> float:
    """Rec. 601 luma of `#rrggbb`, 0 to 255."""
    red, green, blue = (int(color[k : k + 2], 16) for k in (1, 3, 5))
    return 0.299 * red + 0.587 * green + 0.114 * blue


def linear(color: str) -> np.ndarray:
    return (np.array([int(color[k : k + 2], 16) for k in (1, 3, 5)]) / 255) ** 2.2


@pytest.mark.parametrize(("colors", "paper"), [(LIGHT, 255.0), (DARK, 22.0)])
def test_lightness_alone_tells_them_apart(colors: tuple[str, ...], paper: float) -> None:
    values = sorted([paper, *map(luma, colors)])
    assert min(b - a for a, b in itertools.pairwise(values)) > 24


@pytest.mark.parametrize("colors", [LIGHT, DARK])
@pytest.mark.parametrize("kind", DEFICIENCIES)
def test_colour_blind_readers_tell_them_apart(kind: str, colors: tuple[str, ...]) -> None:
    seen = [np.clip(np.array(DEFICIENCIES[kind]) @ linear(c), 0, 1) ** (1 / 2.2) for c in colors]
    assert min(float(np.abs(a - b).max()) for a, b in itertools.combinations(seen, 2)) > 0.1
