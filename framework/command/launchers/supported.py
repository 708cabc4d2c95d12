"""Hydra's launchers that this project supports.

`basic` and `joblib` are Hydra's own. With those of submitit and Ray one lost run ends the study,
and their processes lack the command's folder and environment. So a subclass replaces each, under
the same name (`hydra_plugins/fishersplat_launchers`, where Hydra looks for launchers).
"""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from hydra.core.config_store import ConfigStore
from hydra.core.plugins import Plugins
from omegaconf import OmegaConf

from framework.compute.orphans import end_with_parent

OURS = "hydra_plugins.fishersplat_launchers"
WEEK_MIN = 7 * 24 * 60


@dataclass(frozen=True)
class Launcher:
    """A launcher.

    Attributes:
        extra: this project's extra that installs it.
        needs: the module that comes with the extra.
        ours: module and class below `OURS`.
        defaults: options that differ from Hydra's.
    """

    extra: str
    needs: str
    ours: tuple[str, str]
    defaults: Mapping[str, Any] = field(default_factory=dict)


LAUNCHERS = {  # besides Hydra's own
    "submitit_local": Launcher(
        "submitit",
        "hydra_plugins.hydra_submitit_launcher",
        ("_submitit", "Local"),
        {"n_jobs": -1, "timeout_min": WEEK_MIN, "detach": False},
    ),
    "submitit_slurm": Launcher(
        "slurm",
        "hydra_plugins.hydra_submitit_launcher",
        ("_submitit", "Slurm"),
        # a worker that had no time left continues from its run's checkpoint
        {"max_num_timeout": 10, "detach": False},
    ),
    "ray": Launcher("ray", "hydra_plugins.hydra_ray_launcher", ("_ray", "Ray")),
}


def register_launchers() -> None:
    """Put ours in the place of Hydra's, of those that are installed. Safe to call again."""
    plugins, store = Plugins.instance(), ConfigStore.instance()  # finds Hydra's first
    for name, launcher in LAUNCHERS.items():
        if not _installed(launcher.needs):
            continue
        file, class_name = launcher.ours
        module = importlib.import_module(f"{OURS}.{file}")
        plugins.register(getattr(module, class_name))
        target = f"{module.__name__}.{class_name}"
        declared = store.load(f"hydra/launcher/{name}.yaml").node
        node = OmegaConf.create(OmegaConf.to_container(declared, resolve=False))
        node.update({**launcher.defaults, "_target_": target})
        store.store(group="hydra/launcher", name=name, node=node, provider="fishersplat")


def missing_extra(name: str) -> str | None:
    """Return the missing extra of this project that a launcher needs, or None."""
    launcher = LAUNCHERS.get(name)
    return launcher.extra if launcher and not _installed(launcher.needs) else None


def package_of(name: str) -> str:
    """The package that a remote launcher comes with."""
    return LAUNCHERS[name].needs.rpartition(".")[2].replace("_", "-")


def _installed(module: str) -> bool:
    try:
        return importlib.util.find_spec(module) is not None
    except ModuleNotFoundError:  # of its parent
        return False


def watch_workers() -> None:
    """Make every joblib worker end with this process from its first moment on.

    A run watches its command (`framework.compute.orphans`), but a worker without a run does not. If
    the command is killed while it sends the first run, the worker would wait for the rest for ever.
    """
    from joblib.parallel import LokyBackend, register_parallel_backend

    class Watching(LokyBackend):  # type: ignore[misc]
        def configure(self, *args: Any, **options: Any) -> int:
            workers: int = super().configure(*args, initializer=end_with_parent, **options)
            return workers

    register_parallel_backend("loky", Watching)
