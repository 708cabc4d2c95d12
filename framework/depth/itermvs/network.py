"""Forward pass of IterMVS (Wang, Galliani, Vogel, Pollefeys, CVPR 2022).

The network normalises inverse depth to [0, 1], 0 at the farthest and 1 at the nearest depth. It
matches features of a reference view with those of its neighbours at 32 depths, initialises a hidden
state from the costs, and refines depth with a GRU. Each iteration matches ten depths around the
current one on three pyramid levels. The new state gives depth and confidence. A convex combination
of neighbours upsamples the result by 4.

Photos are [3, H, W] in [-1, 1] with sides that are multiples of 32; level l is 2^l times smaller.
Pixel coordinates are indices, as in the reference implementation: K is not shifted by half a pixel.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

MULTIPLE = 32  # of the sides of a photo
GROUPS = 8  # channels are correlated in groups
HYPOTHESES = 32  # depths of the first matching
BINS, RADIUS = 256, 4  # bins of the depth head; bins around the best that are averaged
ITERATIONS = 4
LEVELS = (1, 2, 3)
OFFSETS = {1: (-2, -2 / 3, 2 / 3, 2), 2: (-8, -8 / 3, 8 / 3, 8), 3: (-32, 32)}  # in bins
SMALLEST_Z = 1e-2  # a point must be this far in front of a neighbour, in the unit of depth
EPSILON = 1e-5

Features = dict[int, Tensor]  # pyramid level -> [1, C, H / 2^level, W / 2^level]


@dataclass(frozen=True)
class Posed:
    """Features of a photo with its camera.

    Attributes:
        features: result of `IterMvs.features`.
        K: [3, 3] float64, intrinsics in pixels of the photo.
        viewmat: [4, 4] float64, world to camera.
    """

    features: Features
    K: Tensor
    viewmat: Tensor

    def projection(self, level: int) -> Tensor:
        """[4, 4] float32, world to pixels of a pyramid level (homogeneous)."""
        K = self.K.clone()
        K[:2] /= 2**level
        projection = self.viewmat.clone()
        projection[:3] = K @ projection[:3]
        return projection.float()


class IterMvs:
    """The network with its weights.

    Args:
        weights: name -> tensor, as `framework.depth.itermvs.weights` stores them (batch norms are
            folded into the convolutions).
    """

    def __init__(self, weights: Mapping[str, Tensor]) -> None:
        self._weights = weights

    @torch.no_grad()
    def features(self, photo: Tensor) -> Features:
        """Compute the feature pyramid of a photo [3, H, W] in [-1, 1]."""
        fine = F.relu(self._conv("features.conv1", photo[None]))
        maps = {}
        x = fine
        for level in LEVELS:
            for block, stride in ((0, 2), (1, 1)):
                x = self._residual(f"features.layer{level}.{block}", x, stride)
            maps[level] = x
        out = {3: self._conv("features.output3", maps[3])}
        merged = maps[3]
        for level in (2, 1):
            lateral = self._conv(f"features.inner{level}", maps[level], padding=0)
            merged = _resized(merged, 2) + lateral
            out[level] = self._conv(f"features.output{level}", merged)
        return out

    @torch.no_grad()
    def depth(
        self, reference: Posed, sources: Sequence[Posed], near: float, far: float
    ) -> tuple[Tensor, Tensor]:
        """Estimate the depth of a reference view.

        Args:
            reference: the view.
            sources: its neighbours, at least one.
            near: nearest depth, in the unit of the cameras.
            far: farthest depth.

        Returns:
            Depth [H, W] between `near` and `far`, and confidence [H, W] in [0, 1].
        """
        height, width = reference.features[2].shape[2:]
        inverse = _InverseDepth(1 / near, 1 / far)
        steps = torch.linspace(0, 1, HYPOTHESES).view(-1, 1, 1)
        hypotheses = steps.expand(-1, height // 2, width // 2)
        costs, visibility = self._first_costs(reference, sources, inverse.depth(hypotheses))
        hidden = F.relu(self._conv("hidden.0", costs[None]))
        hidden = torch.tanh(_resized(self._conv("hidden.2", hidden, padding=0), 2))
        place = self._place(hidden)
        for _ in range(ITERATIONS):
            costs = self._costs(reference, sources, inverse, place, visibility)
            hidden = self._gru(hidden, torch.cat([place, costs])[None])
            place = self._place(hidden)
        confidence = F.relu(self._conv("confidence.0", hidden, padding=2, dilation=2))
        confidence = torch.sigmoid(self._conv("confidence.2", confidence, padding=0))
        fine = self._upsampled(place, reference.features[2])
        return inverse.depth(fine), _resized(confidence, 4)[0, 0]

    def _conv(
        self, name: str, x: Tensor, stride: int = 1, padding: int = 1, dilation: int = 1
    ) -> Tensor:
        weight, bias = self._weights[f"{name}.weight"], self._weights.get(f"{name}.bias")
        return F.conv2d(x, weight, bias, stride=stride, padding=padding, dilation=dilation)

    def _residual(self, name: str, x: Tensor, stride: int) -> Tensor:
        y = F.relu(self._conv(f"{name}.conv1", x, stride))
        y = self._conv(f"{name}.conv2", y)
        if stride > 1:
            x = self._conv(f"{name}.downsample", x, stride)
        return F.relu(x + y)

    def _first_costs(
        self, reference: Posed, sources: Sequence[Posed], depth: Tensor
    ) -> tuple[Tensor, list[Tensor]]:
        """Matching costs [32, h, w] on level 3, and each source's visibility on level 2."""
        target = reference.features[3]
        total, weights, visibility = torch.zeros(()), torch.tensor(EPSILON), []
        for source in sources:
            warped = _warped(source, reference, 3, depth)
            correlation = _correlated(warped, target)  # [D, G, h, w]
            score = F.relu(self._conv("visibility.0", correlation))
            score = self._conv("visibility.1", score, padding=0)[:, 0]
            weight = torch.softmax(score, dim=0).amax(0)
            visibility.append(_resized(weight[None, None], 2)[0, 0])
            total, weights = total + correlation * weight, weights + weight
        return self._regularised(total / weights, 3), visibility

    def _costs(
        self,
        reference: Posed,
        sources: Sequence[Posed],
        inverse: _InverseDepth,
        place: Tensor,
        visibility: Sequence[Tensor],
    ) -> Tensor:
        """Costs [10, h, w] of depths around `place`, from all levels at the size of level 2."""
        result = []
        for level in LEVELS:
            offsets = torch.tensor(OFFSETS[level]).view(-1, 1, 1) / BINS
            depth = inverse.depth((place + offsets).clamp(0, 1))
            target = _resized(reference.features[level], 2.0 ** (level - 2))
            total, weights = torch.zeros(()), torch.tensor(EPSILON)
            for source, weight in zip(sources, visibility, strict=True):
                warped = _warped(source, reference, level, depth)
                total = total + _correlated(warped, target) * weight
                weights = weights + weight
            result.append(self._regularised(total / weights, level))
        return torch.cat(result)

    def _regularised(self, correlation: Tensor, level: int) -> Tensor:
        """Costs [D, h, w] of correlations [D, G, h, w], by a small U-net that sees one depth."""
        name = f"costs{level}"
        fine = F.relu(self._conv(f"{name}.conv0", correlation))
        middle = F.relu(self._conv(f"{name}.conv1", fine, 2))
        x = F.relu(self._conv(f"{name}.conv2", middle, 2))
        x = middle + self._enlarged(f"{name}.conv3", x)
        x = fine + self._enlarged(f"{name}.conv4", x)
        return self._conv(f"{name}.conv5", x)[:, 0]

    def _enlarged(self, name: str, x: Tensor) -> Tensor:
        """Transposed convolution to twice the size."""
        weight = self._weights[f"{name}.weight"]
        return F.conv_transpose2d(x, weight, stride=2, padding=1, output_padding=1)

    def _gru(self, hidden: Tensor, x: Tensor) -> Tensor:
        both = torch.cat([hidden, x], dim=1)
        update = torch.sigmoid(self._conv("gru.convz", both, padding=2, dilation=2))
        reset = torch.sigmoid(self._conv("gru.convr", both, padding=2, dilation=2))
        both = torch.cat([reset * hidden, x], dim=1)
        new = torch.tanh(self._conv("gru.convq", both, padding=2, dilation=2))
        return (1 - update) * hidden + update * new

    def _place(self, hidden: Tensor) -> Tensor:
        """Normalised inverse depth [1, h, w]: the mean over the bins around the likeliest."""
        x = F.relu(self._conv("depth.0", hidden, padding=2, dilation=2))
        x = F.relu(self._conv("depth.2", x, padding=0))
        probability = torch.softmax(self._conv("depth.4", x, padding=0)[0], dim=0)
        best = probability.argmax(0, keepdim=True)
        around = torch.arange(-RADIUS, RADIUS + 1).view(-1, 1, 1)
        bins = (best + around).clamp(0, BINS - 1)
        chances = probability.gather(0, bins)
        mean = (bins * chances).sum(0, keepdim=True) / (chances.sum(0, keepdim=True) + 1e-6)
        return mean / (BINS - 1)

    def _upsampled(self, place: Tensor, features: Tensor) -> Tensor:
        """`place` [1, h, w] at 4 times the size: convex combinations of 3x3 neighbours."""
        _, height, width = place.shape
        weights = F.relu(self._conv("upsample.0", features))
        weights = self._conv("upsample.2", weights, padding=0)
        weights = torch.softmax(weights.view(9, 4, 4, height, width), dim=0)
        padded = F.pad(place[None], (1, 1, 1, 1), mode="replicate")
        neighbours = F.unfold(padded, 3).view(9, 1, 1, height, width)
        fine = (neighbours * weights).sum(0)  # [4, 4, h, w]
        return fine.permute(2, 0, 3, 1).reshape(4 * height, 4 * width)


@dataclass(frozen=True)
class _InverseDepth:
    """The range of inverse depth that [0, 1] represents."""

    near: float
    far: float

    def depth(self, place: Tensor) -> Tensor:
        return 1 / (self.far + place * (self.near - self.far))


def _resized(x: Tensor, factor: float) -> Tensor:
    """Bilinear, pixel areas aligned."""
    if factor == 1:
        return x
    return F.interpolate(x, scale_factor=factor, mode="bilinear", align_corners=False)


def _correlated(warped: Tensor, target: Tensor) -> Tensor:
    """Group-wise correlations [D, G, h, w] of features [C, D, h, w] and [1, C, h, w]."""
    channels, depths, height, width = warped.shape
    split = (GROUPS, channels // GROUPS)
    product = warped.view(*split, depths, height, width) * target.view(*split, 1, height, width)
    return product.mean(1).transpose(0, 1).contiguous()


def _warped(source: Posed, reference: Posed, level: int, depth: Tensor) -> Tensor:
    """Features [C, D, h, w] of a source where the reference's pixels lie at depths [D, h, w]."""
    features = source.features[level]
    rows, columns = features.shape[2:]
    depths, height, width = depth.shape
    transfer = source.projection(level) @ torch.inverse(reference.projection(level))
    y, x = torch.meshgrid(
        torch.arange(height) * (rows / height),
        torch.arange(width) * (columns / width),
        indexing="ij",
    )
    rays = transfer[:3, :3] @ torch.stack([x, y, torch.ones_like(x)]).view(3, -1)
    points = rays[:, None] * depth.view(1, depths, -1) + transfer[:3, 3].view(3, 1, 1)
    visible = points[2] > SMALLEST_Z
    z = torch.where(visible, points[2], 1.0)
    u = torch.where(visible, points[0] / z, float(columns)) / ((columns - 1) / 2) - 1
    v = torch.where(visible, points[1] / z, float(rows)) / ((rows - 1) / 2) - 1
    grid = torch.stack([u, v], dim=-1).view(1, depths * height, width, 2)
    warped = F.grid_sample(features, grid, "bilinear", "zeros", align_corners=True)
    return warped.view(-1, depths, height, width)
