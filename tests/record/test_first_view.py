"""`settings.json` of a run: where the first picture is seen from, and the background."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
import torch

from framework.records.first_view import SETTINGS, write_settings
from framework.types import View
from tests.exports.folders import FOCAL, HEIGHT, WIDTH, side_by_side

BLUE = torch.tensor([0.1, 0.2, 0.9])


def told_of(folder: Path, means: torch.Tensor) -> dict[str, dict[str, list[float]]]:
    views = [View(str(k), c, torch.zeros(3, HEIGHT, WIDTH)) for k, c in enumerate(side_by_side(5))]
    write_settings(folder, views, means, BLUE, near=0.02)
    return dict(json.loads((folder / SETTINGS).read_text()))


def test_the_middle_camera_sees_the_first_picture(tmp_path: Path) -> None:
    behind, aside = [[0.0, 0.0, -9.0]] * 60, [[30.0, 0.0, 6.0]] * 60
    ahead = [[0.0, 0.0, 0.0]] * 40
    message = told_of(tmp_path, torch.tensor(behind + aside + ahead))
    center = side_by_side(5)[2].center.numpy()
    assert message["camera"]["position"] == pytest.approx(list(center * [-1, -1, 1]))
    assert np.allclose(message["camera"]["target"], 0, atol=1e-6)
    assert message["camera"]["fov"] == pytest.approx(math.degrees(2 * math.atan(WIDTH / 2 / FOCAL)))
    assert message["background"]["color"] == pytest.approx(BLUE.tolist())


def test_where_nothing_is_seen(tmp_path: Path) -> None:
    message = told_of(tmp_path, torch.zeros(0, 3))
    place, target = (np.array(message["camera"][key]) for key in ("position", "target"))
    assert np.linalg.norm(target - place) == pytest.approx(2.0)
