"""The training photos of a run, beside its renders: `photos/<view>.jpg`, for whoever looks at it.

They are copies for looking at (JPEG of quality 90, a sixth of a PNG), at the size the run worked
with. The test photos lie, without a loss, in `renders/`.
"""

from __future__ import annotations

import functools
import io
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from framework.compute.parallel import run_tasks
from framework.files.whole import write_whole
from framework.metrics.evaluate import quantise
from framework.records.run_files import file_stems

if TYPE_CHECKING:
    from framework.types import View

PHOTOS = "photos"
QUALITY = 90


def photo_files(names: Sequence[str]) -> list[str]:
    """Where the photos of the training views `names`, in the order of a run's record, lie in its
    folder."""
    return [f"{PHOTOS}/{stem}.jpg" for stem in file_stems(names)]


def write_photos(run_dir: Path, training: Sequence[View]) -> None:
    """Write them."""
    files = [run_dir / name for name in photo_files([view.name for view in training])]
    pairs = zip(files, training, strict=True)
    run_tasks([functools.partial(_write, file, view) for file, view in pairs])


def _write(file: Path, view: View) -> None:
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(quantise(view.image)).save(buffer, "JPEG", quality=QUALITY, subsampling=0)
    write_whole(file, buffer.getvalue())
