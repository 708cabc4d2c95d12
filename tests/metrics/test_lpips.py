"""LPIPS with small random weights in the authors' layout, against torch modules stacked as the
VGG-16 and AlexNet feature extractors are."""

from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from framework.compute.rng import stream
from framework.metrics import evaluate as metrics
from framework.metrics import lpips, winograd

CHANNELS = 16
CUTS = {"VGG-16": (4, 9, 16, 23, 30), "AlexNet": (2, 5, 8, 10, 12)}


def features(kind: str) -> nn.Sequential:
    """The layers with their published indices, with `CHANNELS` channels throughout."""

    def conv(inputs: int, *shape: int) -> list[nn.Module]:
        kernel, stride, padding = shape
        return [nn.Conv2d(inputs, CHANNELS, kernel, stride, padding), nn.ReLU()]

    layers: list[nn.Module] = []
    if kind == "VGG-16":
        for stage, count in enumerate((2, 2, 3, 3, 3)):
            for _ in range(count):
                layers += conv(3 if not layers else CHANNELS, 3, 1, 1)
            layers += [nn.MaxPool2d(2, 2)] if stage < 4 else []
        return nn.Sequential(*layers)
    layers += [*conv(3, 11, 4, 2), nn.MaxPool2d(3, 2), *conv(CHANNELS, 5, 1, 2), nn.MaxPool2d(3, 2)]
    for _ in range(3):
        layers += conv(CHANNELS, 3, 1, 1)
    return nn.Sequential(*layers)


def state_dict(kind: str, net: nn.Sequential) -> dict[str, Tensor]:
    draw = stream(0, f"lpips/{kind}")
    state = {
        "scaling_layer.shift": torch.tensor([-0.03, -0.088, -0.188])[None, :, None, None],
        "scaling_layer.scale": torch.tensor([0.458, 0.448, 0.45])[None, :, None, None],
    }
    with torch.no_grad():
        for parameter in net.parameters():
            parameter.copy_(torch.from_numpy(0.3 * draw.standard_normal(tuple(parameter.shape))))
    for index, layer in enumerate(net):
        stage = next(s for s, cut in enumerate(CUTS[kind]) if index < cut)
        if isinstance(layer, nn.Conv2d):
            for name, parameter in layer.named_parameters():
                state[f"net.slice{stage + 1}.{index}.{name}"] = parameter.detach()
    for stage in range(5):
        weight = torch.from_numpy(draw.random((1, CHANNELS, 1, 1))).float()
        state[f"lin{stage}.model.1.weight"] = weight
    return state


@pytest.mark.parametrize("kind", sorted(CUTS))
def test_distance_equals_the_stacked_modules(kind: str, tmp_path: Path) -> None:
    net = features(kind)
    state = state_dict(kind, net)
    torch.save(state, tmp_path / "weights.pth")
    draw = stream(0, "lpips/images")
    x, y = draw.random((40, 48, 3)), draw.random((40, 48, 3))

    def stages(image: np.ndarray) -> list[Tensor]:
        h = 2 * torch.from_numpy(image).permute(2, 0, 1).float()[None] - 1
        h = (h - state["scaling_layer.shift"]) / state["scaling_layer.scale"]
        actual, start = [], 0
        for cut in CUTS[kind]:
            h = net[start:cut](h)
            actual.append(h / (h.norm(dim=1, keepdim=True) + 1e-10))
            start = cut
        return actual

    with torch.no_grad():
        expected = sum(
            float(((a - b) ** 2 * state[f"lin{i}.model.1.weight"]).sum(1).mean())
            for i, (a, b) in enumerate(zip(stages(x), stages(y), strict=True))
        )
    network = lpips.load(tmp_path / "weights.pth")
    assert expected > 1e-3
    assert network.distance(x, y) == pytest.approx(expected, rel=1e-5)
    assert network.distance(x, x) == 0.0
    assert isinstance(network.distance(x[:8], y[:8]), metrics.Missing)


@pytest.mark.parametrize("size", [(37, 50), (16, 16), (5, 3), (1, 1)])
def test_winograd_equals_direct_convolution(size: tuple[int, int]) -> None:
    draw = stream(0, "lpips/winograd")
    h, weight, bias = (
        torch.from_numpy(draw.standard_normal(shape)).float()
        for shape in ((*size, 48), (32, 48, 3, 3), (32,))
    )
    actual = winograd.convolve(h, winograd.transformed(weight), bias)
    direct = nn.functional.conv2d(
        h.double().permute(2, 0, 1)[None], weight.double(), bias.double(), padding=1
    )
    expected = direct[0].permute(1, 2, 0).relu()
    assert float((actual - expected).abs().max()) < 2e-5 * float(expected.max())


def test_distance_in_bands_of_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    torch.save(state_dict("VGG-16", features("VGG-16")), tmp_path / "weights.pth")
    network = lpips.load(tmp_path / "weights.pth")
    draw = stream(0, "lpips/bands")
    x, y = draw.random((53, 37, 3)), draw.random((53, 37, 3))
    whole = network.distance(x, y)
    monkeypatch.setattr(lpips, "BAND", 8 * 37)
    assert network.distance(x, y) == pytest.approx(whole, rel=1e-5)
    assert network.distance(x, x) == 0.0
