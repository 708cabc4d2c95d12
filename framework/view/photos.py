"""The photos of a page: small WebP copies, within a budget of bytes for all of them."""

import base64
import io
from collections.abc import Sequence
from pathlib import Path

from framework.scenes.images import read_image

BYTES = 4_000_000  # of all photos of a page, about, before base64
LONGEST, SHORTEST = 1280, 320  # pixels of a copy's longer side: at most; however many there are
QUALITY, EFFORT = 82, 4
BYTES_PER_PIXEL = 0.2  # of a WebP copy of this quality, rather too much


def copies(files: Sequence[Path]) -> list[str]:
    """Data URIs.

    Raises:
        UserError: for a file that is no image.
    """
    return [_copy(file, _longest(len(files))) for file in files]


def _longest(count: int) -> int:
    """Pixels of the longer side, so that `count` copies keep to the budget."""
    pixels = BYTES / max(1, count) / BYTES_PER_PIXEL
    return int(min(LONGEST, max(SHORTEST, (pixels * 4 / 3) ** 0.5)))


def _copy(file: Path, longest: int) -> str:
    from PIL import Image

    image = Image.fromarray(read_image(file))
    image.thumbnail((longest, longest), Image.Resampling.LANCZOS)
    buffer = io.BytesIO()
    image.save(buffer, "WEBP", quality=QUALITY, method=EFFORT)
    return "data:image/webp;base64," + base64.b64encode(buffer.getvalue()).decode("ascii")
