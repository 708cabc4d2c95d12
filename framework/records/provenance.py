"""Where a result comes from: code, package versions, machine; and the identity of a run.

Two runs have the same identity if nothing that can change their bits differs. That is the resolved
config without `NEUTRAL_KEYS`, the loaded scene, other files that were read, the sources of the
framework and of the plugins in use, and the package versions. No host name and no path of the
machine is recorded, except in the user's config.
"""

import functools
import hashlib
import importlib.util
import json
import math
import os
import platform
import subprocess
import sys
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import framework
from framework.compute.parallel import threads
from framework.files.paths import own_plugins

ROOT = Path(framework.__file__).resolve().parent.parent
NEUTRAL_KEYS = ("threads", "force", "study", "traceback", "estimate", "tracker", "hydra")
PACKAGES = (
    *("torch", "numpy", "numba", "llvmlite", "scipy", "scikit-image"),
    *("pycolmap", "opencv-contrib-python-headless", "hydra-core"),
)
MAKING = ("run.py", "pyproject.toml", "framework", "plugins", "conf", "sweeps")  # a result
# rooms that no result depends on
SHOWING = tuple(f"framework/{room}/" for room in ("exports", "report", "view"))
BITS = "bits"  # of a run whose rasterizer does not keep them: why its repetition differs


def provenance() -> dict[str, Any]:
    """Versions, git state (None outside a checkout), CPU, threads: all JSON values."""
    folders = [place for place, _ in own_plugins()]
    return {
        "fishersplat": framework.__version__,
        "python": platform.python_version(),
        "packages": package_versions(),
        "git": git_state(ROOT),
        "code": code_hash(),
        **({"own_plugins": folders} if folders else {}),
        "cpu": cpu_model(),
        "cores": os.cpu_count(),
        "threads": threads(),
        "system": f"{platform.system()} {platform.machine()}",
    }


@functools.cache
def package_versions() -> dict[str, str | None]:
    """Installed versions of the packages a result depends on; None for one not installed."""
    versions: dict[str, str | None] = {}
    for package in PACKAGES:
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            versions[package] = None
    return versions


def git_state(root: Path) -> dict[str, Any] | None:
    """{"sha", "dirty"} of the checkout that tracks `root`/framework; None where there is none.
    dirty: whether something of `MAKING` differs from the commit, files that it lacks included."""
    # an installed copy may lie inside somebody else's repository, which says nothing about it
    if _git(root, "ls-files", "--error-unmatch", "framework/__init__.py") is None:
        return None
    sha = _git(root, "rev-parse", "HEAD")
    status = _git(root, "status", "--porcelain", "--", *MAKING)
    if sha is None or status is None:
        return None
    return {"sha": sha, "dirty": bool(status)}


@functools.cache
def code_hash() -> str:
    """SHA-256 over the sources of framework/ without `SHOWING`; taken once per process, since that
    is the code it runs. Plugins are hashed by `framework.run.plugin_code`."""
    digest = hashlib.sha256()
    for name, path in _sources(ROOT):
        digest.update(f"{name}\0".encode() + hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()


def identity_of(
    config: Mapping[str, Any], scene_fingerprint: str, code_hash: str, files: Mapping[str, str]
) -> str:
    """SHA-256 hex of all that determines a run's result; see the module's text.

    Args:
        files: purpose -> fingerprint of the files beside the scene that the config only names.
    """
    effective = {key: value for key, value in config.items() if key not in NEUTRAL_KEYS}
    content = {
        "config": effective,
        "scene": scene_fingerprint,
        "files": dict(files),
        "code": code_hash,
        "packages": package_versions(),
    }
    return hashlib.sha256(strict_json(content).encode()).hexdigest()


def strict_json(value: Any, indent: int | None = None, compact: bool = False) -> str:
    """JSON with sorted keys, of plain values only. A non-finite number becomes null; another field
    explains it.

    Args:
        compact: without blanks.
    """
    return json.dumps(
        plain_json(value),
        indent=indent,
        sort_keys=True,
        allow_nan=False,
        ensure_ascii=False,
        separators=(",", ":") if compact else None,
    )


def cpu_model() -> str:
    """The name of the processor."""
    if Path("/proc/cpuinfo").is_file():
        for line in Path("/proc/cpuinfo").read_text(errors="replace").splitlines():
            key, _, value = line.partition(":")
            if key.strip() in ("model name", "Model") and value.strip():
                return value.strip()
    return platform.processor() or platform.machine()


def peak_memory_bytes() -> int:
    """Largest resident size of this process since its start or `reset_peak_memory`; 0 if the
    system does not report it."""
    status = Path("/proc/self/status")
    if status.is_file():
        for line in status.read_text().splitlines():
            if line.startswith("VmHWM:"):
                return 1024 * int(line.split()[1])
    if importlib.util.find_spec("resource") is None:
        return 0
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else 1024 * peak


def reset_peak_memory() -> bool:
    """Start a new peak, so that a run is not charged with an earlier run of the same process.
    Linux only (`/proc/self/clear_refs`); returns whether it was possible."""
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        return False
    return True


def _git(root: Path, *arguments: str) -> str | None:
    try:
        done = subprocess.run(
            ["git", "-C", str(root), *arguments], capture_output=True, text=True, timeout=30
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout.strip() if done.returncode == 0 else None


def _sources(root: Path) -> list[tuple[str, Path]]:
    files = (root / "framework").rglob("*.py")
    named = {path.relative_to(root).as_posix(): path for path in files}
    return [(n, named[n]) for n in sorted(named) if not n.startswith(SHOWING)]


def plain_json(value: Any) -> Any:
    """Return the dicts, lists and finite numbers that `strict_json` writes."""
    if isinstance(value, Mapping):
        return {str(key): plain_json(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain_json(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, Path):
        return str(value)
    return value
