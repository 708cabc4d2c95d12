"""Colours stay apart in greyscale and for the colour-blind."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from framework.report.figures.palette import (
    DARK,
    DASHES,
    LIGHT,
    LOOKS,
    MARKERS,
    look_of,
    looks,
)

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


def test_looks_of_equal_colour_differ_in_line_and_marker() -> None:
    lines = [(look_of(k).color, str(look_of(k).dash)) for k in range(LOOKS)]
    marks = [(look_of(k).color, look_of(k).marker) for k in range(LOOKS)]
    assert len(set(lines)) == len(set(marks)) == LOOKS == len(LIGHT) * len(DASHES)
    assert len(MARKERS) == len(LIGHT) == len(DARK)


def test_a_method_keeps_its_look_in_every_report() -> None:
    alone = {name: looks([name])[name] for name in ("none + none", "none + uar", "safi + none")}
    assert alone == {"none + none": 0, "none + uar": 1, "safi + none": 2}
    crowd = looks([*alone, "a + b", "none + uar, reg.p=0.2", "z + none"])
    assert {name: crowd[name] for name in alone} == alone
    assert looks(["z + none"]) == looks(["z + none"])
    assert len(set(crowd.values())) == len(crowd)


def test_there_may_be_more_methods_than_looks() -> None:
    actual = looks([f"method {k}" for k in range(LOOKS + 3)])
    assert len(actual) == LOOKS + 3 and set(actual.values()) == set(range(LOOKS))
