"""The training photos that a run keeps for whoever looks at it."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from framework.metrics.evaluate import quantise
from framework.records.run_files import photo_files, write_photos
from framework.scenes.images import read_image
from tests.record.fakes import make_view


def test_the_photos_are_those_of_this_run(tmp_path: Path) -> None:
    first, second = make_view(0), replace(make_view(1), name="../a b.JPG")
    write_photos(tmp_path, [first, second])
    files = photo_files([first.name, second.name])
    assert sorted(p.name for p in (tmp_path / "photos").iterdir()) == sorted(
        Path(name).name for name in files
    )
    for name, view in zip(files, (first, second), strict=True):
        off = read_image(tmp_path / name).astype(float) - quantise(view.image)
        assert np.abs(off).mean() < 2
