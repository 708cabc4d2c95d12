"""`hydra/launcher=ray`: the runs are tasks of a Ray cluster, or of a small one started here.

It differs from Hydra's launcher of this name. A run's configuration is composed where it runs, so
the command only holds a line per run. If a worker is killed, another resumes its run from the
checkpoint (`ray.remote.max_retries`, 3 times). A lost run does not end the study.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hydra.core.singleton import Singleton
from hydra.core.utils import JobReturn, run_job, setup_globals
from hydra_plugins.hydra_ray_launcher.ray_launcher import RayLauncher
from omegaconf import OmegaConf, open_dict

from framework.command.launchers.sent import Arrivals, Origin, origin
from framework.command.studies.study import Outcome

OBJECTS_BYTES = 80_000_000  # Ray's least; runs exchange nothing but their outcome
ENVIRONMENT = {
    "RAY_USAGE_STATS_ENABLED": "0",  # no usage statistics are sent
    "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",
}


class Ray(RayLauncher):
    """As many runs at a time as the cluster has room for."""

    def launch(
        self, job_overrides: Sequence[Sequence[str]], initial_job_idx: int
    ) -> Sequence[JobReturn]:
        """Do the runs; returns those with an outcome."""
        for name, text in ENVIRONMENT.items():
            os.environ.setdefault(name, text)
        import ray

        assert self.config is not None
        Path(str(self.config.hydra.sweep.dir)).mkdir(parents=True, exist_ok=True)
        ray.init(**_start(OmegaConf.to_container(self.ray_cfg.init, resolve=True)))
        try:
            return self._launched(ray, job_overrides, initial_job_idx)
        finally:
            ray.shutdown()

    def _launched(
        self, ray: Any, job_overrides: Sequence[Sequence[str]], first: int
    ) -> Sequence[JobReturn]:
        asked: Any = OmegaConf.to_container(self.ray_cfg.remote, resolve=True)
        task = ray.remote(**({"num_cpus": 1, "max_retries": 3} | asked))(_do)
        state = Singleton.get_state()
        study = Study(self.hydra_context, self.config, self.task_function, state, origin(False))
        stored = ray.put(study)
        seen = Arrivals(len(job_overrides))
        running = {task.remote(stored, list(o), first + i): o for i, o in enumerate(job_overrides)}
        while running:
            for ended in ray.wait(list(running), num_returns=1)[0]:
                overrides = running.pop(ended)
                try:
                    seen.arrived(ray.get(ended))
                except ray.exceptions.RayError as error:
                    seen.lost(overrides, str(error).strip().splitlines()[-1])
        return list(seen.returns.values())


@dataclass(frozen=True)
class Study:
    """What all runs of a launch share."""

    context: Any
    config: Any
    task_function: Any
    state: Any
    origin: Origin


def _do(study: Study, overrides: list[str], number: int) -> Outcome:
    """One run, in a process of Ray's."""
    study.origin.take()
    setup_globals()
    Singleton.set_state(study.state)
    config = study.context.config_loader.load_sweep_config(study.config, overrides)
    with open_dict(config):
        config.hydra.job.id, config.hydra.job.num = f"job_id_for_{number}", number
    outcome: Outcome = run_job(
        hydra_context=study.context,
        task_function=study.task_function,
        config=config,
        job_dir_key="hydra.sweep.dir",
        job_subdir_key="hydra.sweep.subdir",
    ).return_value
    return outcome


def _start(asked: Any) -> dict[str, Any]:
    """The words of `ray.init`; sizes are for a cluster that is started here."""
    quiet = {"logging_level": logging.ERROR, "log_to_driver": False}
    if asked.get("address"):
        return quiet | asked
    return quiet | {"object_store_memory": OBJECTS_BYTES, "include_dashboard": False} | asked
