"""Runs that only note their configuration, in a folder of their own."""

import copy
import functools
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

import framework.report
from framework.command import runner
from framework.command.config.naming import plain
from framework.command.config.schema import CONF_DIR, register_config
from framework.command.runner import Job
from framework.command.studies import estimate
from framework.errors import UserError


def composed(*overrides: str) -> dict[str, Any]:
    return copy.deepcopy(_composed(overrides))


def last_values(sweep: Path) -> dict[str, str]:
    """The last value of everything a sweep varies: one start instead of a hundred."""
    params = OmegaConf.load(sweep).hydra.sweeper.params
    return {str(key): str(values).split(",")[-1] for key, values in params.items()}


@dataclass
class FakeRuns:
    """seen: what each run got. outcome by seed: an exception to raise instead of finishing."""

    seen: list[dict[str, Any]] = field(default_factory=list)
    folders: list[Path] = field(default_factory=list)
    failures: dict[int, BaseException] = field(default_factory=dict)

    def run(self, job: Job) -> bool:
        self.seen.append(job.config)
        self.folders.append(Path(job.run_dir).relative_to(Path.cwd()))
        failure = self.failures.get(job.config["seed"])
        if failure is not None:
            raise failure
        print(f"{job.label} · finished")
        return True

    def measure(self, config: dict[str, Any]) -> estimate.Cost:
        """A tenth of a second per step, two seconds per run, three per scene."""
        return estimate.Cost(0.1, 2.0, 3.0)

    @property
    def methods(self) -> list[tuple[str, str, int]]:
        return [(c["augment"]["name"], c["reg"]["name"], c["seed"]) for c in self.seen]


def fake_report(study_dir: Path) -> Path:
    if study_dir.name == "unreportable":
        raise UserError("nothing to report")
    path = study_dir / "report.md"
    path.write_text("report", encoding="utf-8")
    return path


@pytest.fixture
def runs(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> FakeRuns:
    """The command line in an empty folder, with runs and reports that take no time."""
    fake = FakeRuns()
    monkeypatch.setenv("FISHERSPLAT_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(runner, "run", fake.run)
    monkeypatch.setattr(framework.report, "build_report", fake_report)
    monkeypatch.setattr(estimate, "measure", fake.measure)
    work = tmp_path / "work"
    work.mkdir()
    monkeypatch.chdir(work)
    return fake


@functools.cache
def _composed(overrides: tuple[str, ...]) -> dict[str, Any]:
    register_config()
    with initialize_config_dir(config_dir=str(CONF_DIR), version_base="1.3"):
        return plain(compose("config", list(overrides)))
