"""How many Gaussians fit into a file of `fishersplat export --compact` (option `bytes`).

Measured (benchmarks/results/exports.md): 14.9 to 17.3 bytes for a Gaussian without SH bands and up
to 0.7 more for each coefficient of three channels. The constants are a little larger, so that the
file is below the limit. Light to import.
"""

import re

UNITS = {"": 1, "b": 1, "kb": 1_000, "mb": 1_000_000}
SIZE = re.compile(r"(\d{1,12}(?:\.\d{1,6})?) ?([a-z]*)", re.ASCII | re.IGNORECASE)
EXPECTED = "a size of at least 1 kB, as 300kB or 1.5MB, or none"
UNLIMITED = "none"
MINIMUM = 1_000  # bytes
HEADER = 100  # bytes of a file beside its Gaussians
GAUSSIAN, COEFFICIENT = 18.0, 1.0


def file_bytes(text: str) -> int | None:
    """Return the bytes that an option names; 0 for "none", and None for what is no size of
    1 kB or more."""
    if text == UNLIMITED:
        return 0
    match = SIZE.fullmatch(text.strip())
    if match is None or match[2].lower() not in UNITS:
        return None
    size = int(float(match[1]) * UNITS[match[2].lower()])
    return size if size >= MINIMUM else None


def most_gaussians(size: int, sh_degree: int) -> int:
    """Return how many Gaussians of an SH degree fit into `size` bytes; at least 1."""
    each = GAUSSIAN + COEFFICIENT * ((sh_degree + 1) ** 2 - 1)
    return max(1, int((size - HEADER) / each))
