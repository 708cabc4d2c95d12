"""IterMVS agrees with its reference implementation, and depth is used only where it is sure."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from framework.depth.itermvs.network import IterMvs, Posed
from framework.depth.itermvs.views import fused
from framework.depth.itermvs.weights import converted, fetch, read_checkpoint, require_weights
from framework.errors import UserError
from framework.types import DepthMap

PUBLISHED = Path(__file__).parents[2].parent / "shared" / "data" / "weights"
CHECKPOINT = PUBLISHED / "itermvs_blendedmvs.ckpt"
needs_weights = pytest.mark.skipif(not CHECKPOINT.is_file(), reason="no IterMVS weights here")


@needs_weights
@pytest.mark.parametrize("scene", ["dtu_scan24", "llff_horns"])
def test_the_network_reproduces_its_reference(scene: str) -> None:
    inputs = np.load(PUBLISHED / "reference" / f"{scene}.npz")
    network = IterMvs(read_checkpoint(CHECKPOINT))
    photos = torch.from_numpy(inputs["photos"]).float() * 2 / 255 - 1
    views = [
        Posed(network.features(photo), torch.from_numpy(K), torch.from_numpy(viewmat))
        for photo, K, viewmat in zip(photos, inputs["K"], inputs["viewmats"], strict=True)
    ]
    depth, confidence = network.depth(
        views[0], views[1:], float(inputs["near"]), float(inputs["far"])
    )
    error = np.abs(depth.numpy() / inputs["depth"] - 1)
    assert np.mean(error < 1e-3) > 0.99
    assert np.mean(np.abs(confidence.numpy() - inputs["confidence"]) < 1e-2) > 0.99


@needs_weights
def test_a_checkpoint_is_converted_into_the_cache(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FISHERSPLAT_CACHE", str(tmp_path))
    assert fetch(CHECKPOINT) == require_weights("blendedmvs")


def test_missing_weights_are_named_with_the_command_that_fetches_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FISHERSPLAT_CACHE", str(tmp_path))
    with pytest.raises(UserError, match="fishersplat fetch itermvs --from FILE"):
        require_weights("dtu")


def test_another_file_is_refused(tmp_path: Path) -> None:
    other = tmp_path / "model.ckpt"
    other.write_bytes(b"something else")
    with pytest.raises(UserError, match="none of the known IterMVS checkpoints"):
        fetch(other)


def test_batch_norms_are_folded_into_convolutions() -> None:
    generator = torch.Generator().manual_seed(0)
    conv = torch.nn.Conv2d(3, 4, 3, bias=False)
    norm = torch.nn.BatchNorm2d(4).eval()
    norm.running_mean = torch.rand(4, generator=generator)
    norm.running_var = 1 + torch.rand(4, generator=generator)
    prefix = "module.feature_net.conv1"
    state = {f"{prefix}.conv.weight": conv.weight.detach()}
    state |= {f"{prefix}.bn.{key}": value for key, value in norm.state_dict().items()}
    weights = converted(state)
    x = torch.rand(1, 3, 8, 8, generator=generator)
    folded = torch.nn.functional.conv2d(
        x, weights["features.conv1.weight"], weights["features.conv1.bias"]
    )
    torch.testing.assert_close(folded, norm(conv(x)).detach())


def test_fused_depth_prefers_sure_then_swept_then_learned_depth() -> None:
    sure = DepthMap(torch.tensor([1.0, 1.0, 1.0, 1.0]), torch.tensor([0.5, 0.0, 0.0, 0.0]))
    swept = DepthMap(torch.tensor([2.0, 2.0, 2.0, 2.0]), torch.tensor([0.4, 0.4, 0.0, 0.0]))
    learned = DepthMap(torch.tensor([3.0, 3.0, 3.0, 3.0]), torch.tensor([0.3, 0.3, 0.3, 0.0]))
    result = fused(sure, swept, learned)
    assert result.depth.tolist() == [1.0, 2.0, 3.0, 2.0]
    assert result.confidence.tolist() == pytest.approx([0.5, 0.4, 0.3, 0.0])
