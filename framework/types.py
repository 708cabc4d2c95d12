"""The values that cross module borders: frozen, with documented shapes.

Conventions of the whole project:
- Images are planar, `[3, H, W]` float32 in [0, 1]; maps are `[H, W]`.
- `viewmat` is world-to-camera with OpenCV axes (x right, y down, z forward).
- `K` is in pixels; the centre of pixel (0, 0) is at (0.5, 0.5).
- Quaternions are wxyz and need not be normalised.
- Depth is the camera-space z coordinate, in scene units (not the distance along the ray).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from functools import cached_property

import torch
from torch import Tensor

from framework.errors import UserError

DILATION = 0.3  # pixels^2, as in 3DGS
PSEUDO = "pseudo"  # the tag the trainer gives to the views that an augmenter returns


@dataclass(frozen=True)
class Camera:
    """A pinhole camera.

    Attributes:
        viewmat: [4, 4] float64 world-to-camera.
        K: [3, 3] float64, pixels.
        width, height: pixels.
        dilation: pixels^2, added to both variances of a Gaussian on the screen.
    """

    viewmat: Tensor
    K: Tensor
    width: int
    height: int
    dilation: float = DILATION

    def __post_init__(self) -> None:
        if tuple(self.viewmat.shape) != (4, 4) or tuple(self.K.shape) != (3, 3):
            raise ValueError(
                f"Camera: expected viewmat [4, 4] and K [3, 3], got {tuple(self.viewmat.shape)}"
                f" and {tuple(self.K.shape)}"
            )
        object.__setattr__(self, "viewmat", self.viewmat.to(torch.float64))
        object.__setattr__(self, "K", self.K.to(torch.float64))
        if not (torch.isfinite(self.viewmat).all() and torch.isfinite(self.K).all()):
            raise UserError("camera: expected finite pose and intrinsics, got NaN or infinity")
        if self.width < 1 or self.height < 1:
            raise UserError(
                f"camera: expected a size of at least 1x1, got {self.width}x{self.height}"
            )
        if not 0 < self.dilation < math.inf:
            raise UserError(f"camera: expected a finite dilation above 0, got {self.dilation}")

    @cached_property
    def center(self) -> Tensor:
        """[3] float64, the camera's position in the world."""
        rotation, translation = self.viewmat[:3, :3], self.viewmat[:3, 3]
        # in one order: a product of the library's comes out as the processor has it
        x, y, z = rotation * translation[:, None]
        return -(x + y + z)

    def scaled(self, factor: int) -> Camera:
        """The camera of the image box-downsampled by an integer `factor` (floor of the size).

        A mean over factor x factor pixels widens a Gaussian by (factor^2 - 1) / 12 pixels^2. A
        dilation of 0.3 of the larger pixels would widen it more, and Gaussians trained on small
        images would be too thin in large ones.
        """
        if factor == 1:
            return self
        K = self.K.clone()
        K[:2] /= factor
        dilation = (self.dilation + (factor**2 - 1) / 12) / factor**2
        return Camera(self.viewmat, K, self.width // factor, self.height // factor, dilation)


@dataclass(frozen=True)
class View:
    """A camera with what it saw.

    Attributes:
        image: [3, H, W] float32 in [0, 1].
        mask: [H, W] float32 in [0, 1] or None (all valid).
        weight: factor of this view's photometric loss.
        depth: [H, W] float32 exact depth (0 = unknown) where a scene has it; only
            `depth=ground_truth` and diagnostics read it.
        tags: ("interpolating",) or ("extrapolating",) on test views (`framework.scenes.placement`),
            (PSEUDO,) on augmented ones.
        lens: (k1, k2, p1, p2, k3) of the distortion that was taken out of the stored photo
            (`framework.scenes.lens.Distortion`), () for none.
    """

    name: str
    camera: Camera
    image: Tensor
    mask: Tensor | None = None
    weight: float = 1.0
    depth: Tensor | None = None
    tags: tuple[str, ...] = ()
    lens: tuple[float, ...] = ()

    @property
    def pseudo(self) -> bool:
        """Whether an augmenter made it."""
        return PSEUDO in self.tags


@dataclass(frozen=True)
class DepthMap:
    """Depth of a training view.

    Attributes:
        depth: [H, W] float32, 0 = no estimate.
        confidence: [H, W] float32 in [0, 1]. 0 marks a guess that failed the consistency check.
            Only the others may enter an initialisation or warp.
    """

    depth: Tensor
    confidence: Tensor


@dataclass(frozen=True)
class SparsePoints:
    """Triangulated points that at least two *training* views observe.

    Attributes:
        xyz: [M, 3] float64.
        rgb: [M, 3] float32 in [0, 1].
        visible: [M, n_train] bool.
    """

    xyz: Tensor
    rgb: Tensor
    visible: Tensor


@dataclass(frozen=True)
class TrainingSet:
    """The training part of a scene, without test views.

    Attributes:
        paper: the grey in [0, 1] behind transparent photos, None where all are opaque.
        given: whether the user gave near, and far; depth is then searched within them, whatever
            the points say.
    """

    scene: str
    views: tuple[View, ...]
    points: SparsePoints
    near: float
    far: float
    paper: float | None = None
    given: tuple[bool, bool] = (False, False)

    @cached_property  # used in every step
    def extent(self) -> float:
        """1.1 x the largest distance of a training camera to their centroid (3DGS); for a single
        camera, where that is zero, a tenth of the near bound."""
        centers = torch.stack([v.camera.center for v in self.views])
        away = centers - centers.sum(0) / len(centers)
        x, y, z = away.square().unbind(1)
        spread = 1.1 * math.sqrt(float((x + y + z).max()))
        return spread if spread > 0 else 0.1 * self.near


@dataclass(frozen=True)
class Scene:
    """A loaded scene under a named split protocol.

    Attributes:
        fingerprint: SHA-256 of all that was loaded.
    """

    name: str
    protocol: str
    training: TrainingSet
    test: tuple[View, ...]
    fingerprint: str


@dataclass(frozen=True)
class Gaussians:
    """The stored (unactivated) parameters of N Gaussians with SH up to degree d, K = (d+1)^2.

    means [N, 3] · quats [N, 4] wxyz · log_scales [N, 3] · opacity_logits [N] · sh0 [N, 1, 3] ·
    shN [M, K-1, 3]. All of one floating dtype. The first M <= N have SH bands above 0, the others
    one colour from everywhere and nothing stored for more; nearly always M = N.
    """

    means: Tensor
    quats: Tensor
    log_scales: Tensor
    opacity_logits: Tensor
    sh0: Tensor
    shN: Tensor

    def __len__(self) -> int:
        return self.means.shape[0]

    @property
    def sh_degree(self) -> int:
        """The highest degree of any: 0 to 3."""
        return degree_of(self.shN.shape[1]) if len(self.shN) else 0

    def active_degree(self, asked: int | None) -> int:
        """The degree of a render with this option, None for the highest."""
        return self.sh_degree if asked is None else min(asked, self.sh_degree)

    @property
    def scales(self) -> Tensor:
        return self.log_scales.exp()

    @property
    def opacities(self) -> Tensor:
        return self.opacity_logits.sigmoid()

    def items(self) -> tuple[tuple[str, Tensor], ...]:
        """(name, tensor) pairs in the order of declaration."""
        return tuple((name, getattr(self, name)) for name in NAMES)

    def map(self, function) -> Gaussians:  # type: ignore[no-untyped-def]
        """A new set with `function` applied to every tensor."""
        return Gaussians(**{name: function(tensor) for name, tensor in self.items()})

    def to(self, device: str | torch.device) -> Gaussians:
        """The same on another device; what is there already is not copied."""
        return self.map(lambda t: t.to(device))

    def detach(self) -> Gaussians:
        return self.map(Tensor.detach)

    def leaves(self) -> Gaussians:
        """The same memory where it is contiguous, as leaves that gradients are taken in."""
        return self.map(lambda t: t.detach().contiguous().requires_grad_())

    def clone(self) -> Gaussians:
        return self.map(lambda t: t.detach().clone())

    def __getitem__(self, index: Tensor) -> Gaussians:
        """Those that a mask ([N] bool) or row numbers choose. Raises ValueError where row numbers
        put one with SH bands above 0 behind one without (sorted ones never do) or are negative."""
        rows = index.nonzero()[:, 0] if index.dtype == torch.bool else index
        banded = rows < len(self.shN)
        first = rows[: int(banded.sum())]
        if not banded[: len(first)].all() or (rows < 0).any():
            raise ValueError(
                "Gaussians: expected row numbers of those with SH bands first; sort them"
            )
        return self.map(lambda t: t[first if t is self.shN else rows])

    def rows(self, start: int, end: int) -> Gaussians:
        """Gaussians start ... end - 1."""
        return self.map(lambda t: t[start:end])

    def with_bands(self, keep: Tensor) -> Gaussians:
        """Keep SH bands above 0 only for the mask `keep` ([N] bool), whose Gaussians come first."""
        kept = keep[: len(self.shN)]
        rows = torch.cat([kept.nonzero()[:, 0], (~kept).nonzero()[:, 0]])
        rows = torch.cat([rows, torch.arange(len(kept), len(self), device=rows.device)])
        return self.map(lambda t: t[kept if t is self.shN else rows])

    def replace(self, **changes: Tensor) -> Gaussians:
        return replace(self, **changes)


def degree_of(terms: int) -> int:
    """The SH degree of so many coefficients above degree 0."""
    return {0: 0, 3: 1, 8: 2, 15: 3}[terms]


NAMES = tuple(f.name for f in fields(Gaussians))  # looked up many times a step


def concatenate(parts: list[Gaussians]) -> Gaussians:
    """The Gaussians of all `parts`, in order: first all that have SH bands above 0."""
    pieces = [part.rows(0, len(part.shN)) for part in parts]
    pieces += [part.rows(len(part.shN), len(part)) for part in parts]
    return Gaussians(**{name: torch.cat([getattr(p, name) for p in pieces]) for name in NAMES})


def edited(
    gaussians: Gaussians, keep: Tensor | None, bands: Tensor | None, append: Gaussians | None
) -> Gaussians:
    """Keep the Gaussians of the mask `keep`, their SH bands above 0 only for `bands`, and append.

    Both masks are [N] bool; None selects all."""
    if keep is not None:
        gaussians, bands = gaussians[keep], None if bands is None else bands[keep]
    if bands is not None:
        gaussians = gaussians.with_bands(bands)
    return gaussians if append is None else concatenate([gaussians, append])


@dataclass(frozen=True)
class Render:
    """What a camera sees of the Gaussians.

    Attributes:
        rgb: [3, H, W], composited on the background.
        alpha: [H, W] = 1 - transmittance.
        depth: [H, W] = sum of blend weight x z, not divided by alpha; [0, 0] where the caller of
            `rasterize` did without.
        radii: [N] float32 pixels, the larger half-side of the footprint's box, 0 where culled.
    """

    rgb: Tensor
    alpha: Tensor
    depth: Tensor
    radii: Tensor

    def to(self, device: str | torch.device) -> Render:
        """The same on another device."""
        return Render(*(getattr(self, field.name).to(device) for field in fields(self)))

    @property
    def expected_depth(self) -> Tensor:
        """[H, W] depth / alpha; 0 where nothing is seen."""
        return torch.where(self.alpha > 1e-6, self.depth / self.alpha.clamp(min=1e-6), 0.0)
