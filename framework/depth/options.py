"""The base of all depth providers, and the options of ours. Light to import.

A provider implements `measure` and `fingerprint`; its users call `estimate`, which corrupts the
measured maps for stress studies.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from framework.errors import check_option, nearest_hint, require

if TYPE_CHECKING:
    from framework.types import DepthMap, TrainingSet

NONE = "none"
CORRUPTIONS = ("noise", "bias", "holes", "blur")
DEFAULT_STRENGTH = 0.5
KINDS = ("depth", "inverse_depth")
FILE_ALIGNMENTS = ("scale", "scale_shift", "none")
INVALID = ("error", "mask")
NETWORK_ALIGNMENTS = ("points", "plane_sweep", "none")
DEPTH_ANYTHING_3 = "git+https://github.com/ByteDance-Seed/Depth-Anything-3"  # for pip
ITERMVS_WEIGHTS = ("blendedmvs", "dtu")
PATCH = 14  # pixels per token; the network's input sizes are its multiples


@dataclass(frozen=True, kw_only=True)
class DepthProvider:
    """Base of all providers, with the options they share.

    Attributes:
        corruption: none, or noise, bias, holes or blur; join several by + in their order.
            For instance `noise+holes`.
        strength: strength of all corruptions in [0, 1]; 0 has no effect. The formulas are in
            `framework.depth.corruption`.
        corruption_seed: seed of the corruptions. It does not follow the run's seed, so all seeds of
            a study have the same corrupted depth.
    """

    corruption: str = NONE
    strength: float = DEFAULT_STRENGTH
    corruption_seed: int = 0

    def __post_init__(self) -> None:
        for kind in self.corruptions():
            require(
                kind in CORRUPTIONS,
                f"depth.corruption: unknown corruption '{kind}'; {nearest_hint(kind, CORRUPTIONS)},"
                f" several joined by +, or {NONE}",
            )
        self.check("strength", 0 <= self.strength <= 1, "a number in [0, 1]")
        require(
            self.strength == DEFAULT_STRENGTH or self.corruption != NONE,
            "depth.strength: it is the strength of a corruption, and depth.corruption is none; add"
            f" depth.corruption=KIND ({', '.join(CORRUPTIONS)}) or drop depth.strength",
        )
        self.check("corruption_seed", self.corruption_seed >= 0, "an integer >= 0")

    def check(self, option: str, ok: bool, expected: str) -> None:
        """Raise UserError, with the option's value and what it should be, unless `ok`."""
        check_option(self, "depth", option, ok, expected)

    def corruptions(self) -> tuple[str, ...]:
        """The chosen corruptions in the order they act."""
        return () if self.corruption == NONE else tuple(self.corruption.split("+"))

    def ready(self) -> None:
        """Raise UserError, in one line, where this machine lacks what the provider needs. Quick:
        studies ask before their first run. Most need nothing."""

    def learned_weights(self) -> str:
        """Return the weights of a network that was trained on other scenes; "" if there is none.

        Results that used such weights are reported separately.
        """
        return ""

    def estimate(self, training: TrainingSet) -> tuple[DepthMap, ...]:
        """Estimate one map per training view, in order, with the corruption of the options."""
        maps = self.measure(training)
        if not self.corruptions() or self.strength == 0:
            return maps
        from framework.depth.corruption import corrupt

        return corrupt(maps, self.corruptions(), self.strength, self.corruption_seed)

    def measure(self, training: TrainingSet) -> tuple[DepthMap, ...]:
        """Estimate one map per training view, in order, without corruption."""
        raise NotImplementedError

    def fingerprint(self, training: TrainingSet) -> str:
        """Return the SHA-256 (hex) of the files that `measure` reads; "" if it reads none."""
        return ""


def unspoiled(options: Mapping[str, Any]) -> dict[str, Any]:
    """The options of the same provider without its corruption; the same where it has none."""
    if options.get("corruption", NONE) == NONE:
        return dict(options)
    spoils = ("corruption", "strength", "corruption_seed")
    return {name: value for name, value in options.items() if name not in spoils}


@dataclass(frozen=True)
class PlaneSweepOptions(DepthProvider):
    """Options of `depth=plane_sweep`; penalties are in units of 1 - ZNCC."""

    planes: int = 0  # of inverse depth, evenly spaced; 0 = 96 to 256, a pixel apart
    radius: int = 2  # of the (2 r + 1)^2 window, pixels
    neighbours: int = 4  # views each view is matched with, at most
    penalty_small: float = 0.1  # P1: the match moves by one pixel from pixel to pixel
    penalty_large: float = 1.0  # P2: it moves by more; less so across image edges
    edge: float = 20.0  # P2 is divided by 1 + edge x grey difference
    tolerance: float = 0.03  # relative depth difference at which two views still agree

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check("planes", self.planes == 0 or 3 <= self.planes <= 2048, "0 or 3 to 2048")
        self.check("radius", 1 <= self.radius <= 15, "1 to 15 pixels")
        self.check("neighbours", self.neighbours >= 1, "an integer >= 1")
        self.check("penalty_small", 0 <= self.penalty_small <= 1, "a number in [0, 1]")
        self.check(
            "penalty_large",
            self.penalty_small <= self.penalty_large <= 1,
            f"a number from penalty_small = {self.penalty_small} to 1",
        )
        self.check("edge", self.edge >= 0, "a number >= 0")
        self.check("tolerance", 0 < self.tolerance < 1, "a share in (0, 1)")


@dataclass(frozen=True)
class DepthFileOptions(DepthProvider):
    """Options of `depth=file`."""

    path: str = ""  # folder of the depth maps
    kind: str = "depth"  # what the maps hold: depth or inverse_depth
    align: str = "scale"  # to the sparse points: scale, scale_shift or none (already scene units)
    invalid: str = "error"  # NaN, infinity and negative values: error, or mask (unknown)
    png_scale: float = 1000.0  # png values are divided by it
    straight: bool = False  # maps are of the photos without their lens, not of the stored ones
    tolerance: float = 0.0  # relative, of a cross-view check as in plane_sweep; 0 = trust all

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check("path", self.path != "", "the folder of the depth maps")
        self.check("kind", self.kind in KINDS, f"one of {', '.join(KINDS)}")
        self.check("align", self.align in FILE_ALIGNMENTS, f"one of {', '.join(FILE_ALIGNMENTS)}")
        self.check("invalid", self.invalid in INVALID, f"one of {', '.join(INVALID)}")
        self.check("png_scale", self.png_scale > 0, "a number > 0")
        self.check("tolerance", 0 <= self.tolerance < 1, "a share in [0, 1)")


@dataclass(frozen=True)
class DepthAnything3Options(DepthProvider):
    """Options of `depth=depth_anything_3`."""

    weights: str = "depth-anything/DA3-BASE"  # on the Hugging Face hub, or a local folder
    revision: str = "main"  # branch, tag or commit on the hub
    align: str = "points"  # each view's scale: sparse points, plane_sweep, or none (the poses')
    process_res: int = 504  # longer side of the network's input, pixels
    device: str = "cpu"  # of torch
    tolerance: float = 0.05  # relative, of a cross-view check as in plane_sweep; 0 = trust all

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check("weights", self.weights != "", "a name on the hub or a folder")
        self.check("revision", self.revision != "", "a branch, tag or commit of the hub")
        self.check(
            "align", self.align in NETWORK_ALIGNMENTS, f"one of {', '.join(NETWORK_ALIGNMENTS)}"
        )
        self.check("process_res", self.process_res >= PATCH, f"at least {PATCH} pixels")
        self.check("device", self.device != "", "a torch device (cpu, cuda)")
        self.check("tolerance", 0 <= self.tolerance < 1, "a share in [0, 1)")


@dataclass(frozen=True)
class IterMvsOptions(DepthProvider):
    """Options of `depth=itermvs` and `depth=fused`."""

    weights: str = "blendedmvs"  # blendedmvs, or dtu (whose training scenes include scan 65)
    neighbours: int = 4  # views each view is matched with, at most
    least_confidence: float = 0.1  # of the network; depth below is not used
    tolerance: float = 0.03  # relative depth difference at which two views still agree

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check(
            "weights", self.weights in ITERMVS_WEIGHTS, f"one of {', '.join(ITERMVS_WEIGHTS)}"
        )
        self.check("neighbours", self.neighbours >= 1, "an integer >= 1")
        self.check("least_confidence", 0 <= self.least_confidence <= 1, "a number in [0, 1]")
        self.check("tolerance", 0 < self.tolerance < 1, "a share in (0, 1)")
