"""IterMVS agrees with its reference implementation, and depth is used only where it is sure."""

from pathlib import Path

import numpy as np
import pytest
import torch

from framework.depth.itermvs.network import IterMvs, Posed
from framework.depth.itermvs.weights import fetch, read_checkpoint, require_weights
from framework.errors import UserError

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
