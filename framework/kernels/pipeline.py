"""The stages of a render and of its gradient, on buffers that are kept between steps.

`Workspace.project -> sort -> bin -> blend` makes an image; `blend_backward -> project_backward`
brings its gradient to the parameters. A workspace belongs to one render until its gradient is done.
"""

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from framework.compute.parallel import BLOCKS, run_blocks, threads
from framework.errors import UserError
from framework.kernels.constants import ROW
from framework.kernels.lending import Lender, aligned, grown
from framework.kernels.project import backward, fisher, projection
from framework.kernels.tile import binning, blend, moments
from framework.types import Camera

MAX_ENTRIES = 2**31 - 1  # an int32 counts them
TILE_BLOCKS = 64  # small ones, as some tiles take far longer than others


@dataclass(frozen=True)
class Arrays:
    """The stored parameters as contiguous float32 arrays; see `framework.types.Gaussians`."""

    means: np.ndarray
    quats: np.ndarray
    log_scales: np.ndarray
    logits: np.ndarray
    sh0: np.ndarray
    shN: np.ndarray
    factors: np.ndarray
    offset: np.ndarray

    def flat(self) -> tuple[np.ndarray, ...]:
        """Return all arrays for the kernels, flattened except shN [M, K, 3]."""
        values = (getattr(self, field.name) for field in fields(self))
        return tuple(value if value is self.shN else value.reshape(-1) for value in values)


@dataclass(frozen=True)
class Image:
    """rgb [3, H, W] on the background, alpha [H, W], depth [H, W]: sum of weight x z."""

    rgb: np.ndarray
    alpha: np.ndarray
    depth: np.ndarray

    def flat(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The three arrays flattened, as the kernels read them."""
        return self.rgb.reshape(-1), self.alpha.reshape(-1), self.depth.reshape(-1)


def camera_row(camera: Camera, near: float) -> np.ndarray:
    """The camera as the kernels read it: float32[21], see `ewa`."""
    pose, K = camera.viewmat.tolist(), camera.K.tolist()  # element by element takes far longer
    row = [*pose[0][:3], *pose[1][:3], *pose[2][:3], *(line[3] for line in pose[:3])]
    row += [*camera.center.tolist(), K[0][0], K[1][1], K[0][2], K[1][2], near, camera.dilation]
    return np.array(row, np.float32)


class Workspace:
    """Buffers for renders, which stay while the number of Gaussians does."""

    def __init__(self) -> None:
        self._n = -1
        self.items = np.empty(0, np.int32)
        self.lists = np.empty((0, 2), np.int32)
        self.parts = np.empty((0, 2), np.int32)
        self.sums = np.empty((0, 16), np.float32)
        self.cross = np.empty((0, 16), np.float32)
        self.slopes = np.empty((0, 16), np.float32)
        self.slots: list[np.ndarray] = []
        self.mixed: list[np.ndarray] = []
        # apart, as who keeps one of a lender's arrays keeps all that were lent with it
        self.images, self.gradients, self.radii, self.pulls = (Lender() for _ in range(4))
        self.blocks = Lender()
        self._tiles = (0, 0)

    def _fit_image(self, columns: int, bands: int) -> None:
        if self._tiles == (columns, bands):
            return
        self._tiles = columns, bands
        n_strips = min(binning.STRIPS, columns)
        self.strips = np.tile(np.arange(columns, dtype=np.int32) * n_strips // columns, bands)
        tiles = columns * bands
        sizes = tiles, n_strips, n_strips
        self.counts = tuple(np.empty((BLOCKS, size), np.int32) for size in sizes)
        self.offsets = np.empty(tiles + 1, np.int32)
        self.bounds = np.empty(n_strips + 1, np.int32)
        self.n_slots = np.empty(n_strips, np.int32)

    def _fit(self, n: int) -> None:
        if n > binning.MAX_GAUSSIANS:
            raise UserError(
                f"rasterize: expected at most {binning.MAX_GAUSSIANS} Gaussians, got {n}; lower"
                " init.budget or use a capacity plugin that prunes"
            )
        if n == self._n:
            return
        self._n = n
        self.rows, self.clipped = aligned((n, ROW)), np.empty(n, np.uint8)
        self.bound, self.touched = np.empty(n, np.int32), np.empty(n, np.int32)
        self.n_parts, self.order = np.empty(n, np.int32), np.empty(n, np.int32)
        self.start, self.first = np.empty(n + 1, np.int32), np.empty(n + 1, np.int32)
        self.keys, self.spare = np.empty(n, np.uint64), np.empty(n, np.uint64)

    def project(
        self, arrays: Arrays, camera: Camera, degree: int, near: float, radii: np.ndarray
    ) -> None:
        """Gaussians to the screen: fills rows, clipped, bound and radii [N]."""
        self.arrays, self.degree, self.near = arrays, degree, near
        self.width, self.height = camera.width, camera.height
        self.camera = camera_row(camera, near)
        self._fit_image((camera.width + 15) // 16, (camera.height + 15) // 16)
        self._fit(len(arrays.means))
        run_blocks(
            projection.project,
            arrays.flat(),
            degree,
            self.camera,
            (self.width, self.height),
            (self.rows.reshape(-1), self.clipped, self.bound, radii),
        )

    def sort(self) -> None:
        """Depth order of the visible Gaussians."""
        self.n_visible, entries = binning.depth_order(
            self.rows, self.bound, self.keys, self.spare, self.order, self.start
        )
        if entries > MAX_ENTRIES:
            raise UserError(
                f"rasterize: expected Gaussians that cover at most {MAX_ENTRIES} tiles, got"
                f" {entries} on {self.width}x{self.height} pixels; they are too large, as after a"
                " training that diverged: lower trainer.lr_scales, or the size of the images"
            )

    def bin(self) -> None:
        """The tiles' lists, front to back, and the strips' lists of parts."""
        n, size, first = self.n_visible, (self.width, self.height), self.first
        listed = self.order, self.start, self.touched, self.n_parts
        self.items = items = grown(self.items, int(self.start[n]))
        run_blocks(binning.count_tiles, n, size, self.rows, self.strips, items, listed, self.counts)
        ends = self.offsets, self.bounds, self.n_slots
        binning.prefix_tiles(n, listed, first, self.counts, ends)
        self.lists = grown(self.lists, int(self.offsets[-1]))
        self.parts = grown(self.parts, int(self.bounds[-1]))
        lists = self.lists, self.parts
        run_blocks(binning.fill_tiles, n, self.strips, items, listed, first, self.counts, lists)

    def blend(self, background: np.ndarray, image: Image) -> None:
        """Render into `image`."""
        run_blocks(
            blend.blend,
            self.width,
            self.height,
            self.rows,
            self.offsets,
            self.lists,
            background,
            *image.flat(),
            blocks=TILE_BLOCKS,
        )

    def render(
        self,
        arrays: Arrays,
        camera: Camera,
        background: np.ndarray,
        degree: int,
        near: float,
        image: Image,
        radii: np.ndarray,
    ) -> None:
        """Run all stages; write `image` and radii [N]."""
        self.project(arrays, camera, degree, near, radii)
        self.sort()
        self.bin()
        self.blend(background, image)

    def _scratch(self, kept: list[np.ndarray]) -> list[np.ndarray]:
        """Slots for every thread that works on a strip, as many as the fullest has."""
        n, size = min(threads(), len(self.n_slots)), int(self.n_slots.max())
        kept[:] = [grown(slots, size) for slots in kept[:n]]
        kept += [aligned((size + size // 4, 16)) for _ in range(n - len(kept))]
        return [slots.reshape(-1) for slots in kept]

    def _strips(self) -> tuple[Any, ...]:
        """The lists of tiles and strips, for passes over the strips."""
        lists = self.rows, self.offsets, self.lists
        return self.width, self.height, *lists, self.strips, self.bounds, self.parts, self.n_slots

    def _differentiate(self, kernel: Any, image: Image, gradient: Image) -> None:
        """Run `blend_backward` or `blend_absolute` over the strips, into `sums`."""
        self.sums = grown(self.sums, int(self.bounds[-1]))
        run_blocks(
            kernel,
            self._strips(),
            image.flat(),
            gradient.flat(),
            self.sums.reshape(-1),
            blocks=len(self.n_slots),
            scratch=[(slots,) for slots in self._scratch(self.slots)],
        )

    def blend_backward(self, image: Image, gradient: Image) -> None:
        """Gradient in the image -> per (Gaussian, strip) sums in `sums`."""
        self._differentiate(blend.blend_backward, image, gradient)

    def blend_absolute(self, image: Image, in_rgb: np.ndarray) -> np.ndarray:
        """Sum the absolute gradient in the projected means over pixels.

        Overwrites `sums`, so call it before `blend_backward`.

        Args:
            image: the render.
            in_rgb: gradient in its colours, [3, H, W].

        Returns:
            [N, 2] float32, in pixels.
        """
        nothing = in_rgb.reshape(-1)[:0]
        self._differentiate(blend.blend_absolute, image, Image(in_rgb, nothing, nothing))
        n = len(self.arrays.means)
        owners = np.repeat(np.arange(n), np.diff(self.first[: n + 1]))
        parts = self.sums[: len(owners), :2]
        return np.stack([np.bincount(owners, parts[:, k], n) for k in (0, 1)], 1).astype(np.float32)

    def _direction_buffers(self) -> tuple[np.ndarray, np.ndarray]:
        """slopes and cross of `moments.blend_moments`; empty at SH degree 0."""
        if self.degree == 0:
            return self.slopes[:0], self.cross[:0]
        self.slopes = grown(self.slopes, len(self.rows))
        self.cross = grown(self.cross, int(self.bounds[-1]))
        return self.slopes, self.cross

    def blend_moments(self, image: Image, mask: np.ndarray) -> None:
        """Second moments of the image's derivatives -> `sums`, and with view-dependent colour
        `slopes` and `cross`; see `moments.blend_moments` and `fisher`.

        Args:
            mask: [H, W], or empty: of all pixels.
        """
        self.sums = grown(self.sums, int(self.bounds[-1]))
        slopes, cross = self._direction_buffers()
        slots = self._scratch(self.slots)
        mixed = self._scratch(self.mixed) if self.degree > 0 else [cross.reshape(-1)] * len(slots)
        if self.degree > 0:
            arrays = self.arrays
            run_blocks(
                fisher.colour_slopes,
                arrays.means.reshape(-1),
                arrays.shN,
                self.degree,
                self.camera,
                self.clipped,
                slopes.reshape(-1),
            )
        run_blocks(
            moments.blend_moments,
            self._strips(),
            image.rgb.reshape(-1),
            mask.reshape(-1),
            self.sums.reshape(-1),
            slopes.reshape(-1),
            cross.reshape(-1),
            blocks=len(self.n_slots),
            scratch=list(zip(slots, mixed, strict=True)),
        )

    def projected(self) -> tuple[Any, ...]:
        """Return the inputs of `backward.project_backward` besides the parameters."""
        rows, sums = self.rows.reshape(-1), self.sums.reshape(-1)
        return self.degree, self.camera, rows, self.clipped, self.first, sums

    def project_backward(self, gradient: Arrays) -> None:
        """Sums in `sums` -> gradients of every parameter (all of `gradient` is overwritten)."""
        means, quats, log_scales, logits, _, shN, factors, _ = self.arrays.flat()
        run_blocks(
            backward.project_backward,
            (means, quats, log_scales, logits, shN, factors),
            self.projected(),
            gradient.flat(),
        )

    def information(self, block: np.ndarray, diagonal: np.ndarray) -> None:
        """Moments in `sums` -> Fisher block [N, 6, 6] and diagonal [N, 14]; see `fisher`."""
        arrays = self.arrays
        slopes, cross = self._direction_buffers()
        run_blocks(
            fisher.pull_back_moments,
            arrays.means.reshape(-1),
            arrays.quats.reshape(-1),
            arrays.log_scales.reshape(-1),
            arrays.logits,
            self.camera,
            self.rows.reshape(-1),
            self.clipped,
            self.first,
            self.sums.reshape(-1),
            slopes.reshape(-1),
            cross.reshape(-1),
            block,
            diagonal,
        )
