"""The stated limits: no input file and no configuration makes the program take more than this.

Every reader checks what a header promises against these numbers and the file's size *before* it
allocates. They are far above what sparse-view training on a CPU can use; who meets one gets a line
that names it.
"""

from __future__ import annotations

import importlib.util

from framework.errors import require

MIB = 1 << 20

IMAGE_PIXELS = 50_000_000  # of one image or depth map; a 45 megapixel photo fits
IMAGE_BYTES = 4 * IMAGE_PIXELS  # of one image file
PHOTO_PIXELS = 170_000_000  # of a photo that is reduced while it is read
PHOTO_BYTES = 4 * PHOTO_PIXELS
SCENE_BYTES = 4096 * MIB  # of all images of a scene together, as float32
SIDE_PIXELS = 65_500  # of an image's or camera's longer side
ARRAY_BYTES = 8 * IMAGE_PIXELS  # of one array in a .npy or .npz
PLY_BYTES = 1024 * MIB
MODEL_BYTES = 512 * MIB  # of one file of a COLMAP model
MODEL_CELLS = 250_000_000  # points x images of a COLMAP model: who sees what, a byte each
CHECKPOINT_BYTES = 4096 * MIB
WEIGHTS_BYTES = 512 * MIB  # of LPIPS weights, unpacked
TEXT_BYTES = 64 * MIB  # of one JSON file of a scene
RUN_BYTES = 8 * MIB  # of one JSON or CSV file of a run
CONFIG_BYTES = MIB // 4  # of one YAML file
DEPTH = 32  # of nested lists and mappings in a file of configurations or of a run
TEXT_LENGTH = 10_000  # characters of one text in them, or of a word of the command line
ADDRESS_BYTES = 2048 * MIB  # of a process: 1.6 GB are just enough for a small run
RUNS = 100_000  # of one command


def check_address_space() -> None:
    """Raise MemoryError if the process may use less than `ADDRESS_BYTES`, with which the libraries
    would crash or fail with misleading errors."""
    if importlib.util.find_spec("resource") is None:  # no such limit on this system
        return
    import resource

    allowed, _ = resource.getrlimit(resource.RLIMIT_AS)
    if 0 <= allowed < ADDRESS_BYTES:
        raise MemoryError(
            f"{allowed // MIB:,} MiB of address space where {ADDRESS_BYTES // MIB:,} are needed"
        )


def check_pixels(where: object, width: int, height: int, most: int = IMAGE_PIXELS) -> None:
    """Raise UserError unless width x height is 1 to `most` pixels."""
    fits = 0 < width <= SIDE_PIXELS and 0 < height <= SIDE_PIXELS
    require(
        fits and width * height <= most,
        f"{where}: expected an image of 1 to {most:,} pixels with sides of at most"
        f" {SIDE_PIXELS:,}, got {width}x{height}; resize it",
    )
