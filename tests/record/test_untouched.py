"""A plugin from outside that writes into what it is given spoils its own run, and no other."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import torch

from framework.plugin import DepthProvider, Regularizer, register
from framework.records.progress import Silent
from framework.run import preparation
from framework.run.experiment import run_experiment
from framework.types import DepthMap
from tests.documents.registered import as_before
from tests.record.test_reuse import group, small_config


@pytest.fixture(autouse=True)
def scribblers() -> Iterator[None]:
    with as_before():

        @register("reg", "scribbler")
        @dataclass(frozen=True)
        class Scribbler(Regularizer):
            """Darkens the photo that it sees, in a way that torch does not notice."""

            def loss(self, ctx: Any, state: Any, view: Any, render: Any) -> None:
                view.image.numpy()[:] *= 0.5

        @register("depth", "spoiler")
        @dataclass(frozen=True)
        class Spoiler(DepthProvider):
            """Darkens every photo while it measures. broken: whether it fails after that."""

            broken: bool = False

            def measure(self, training: Any) -> tuple[DepthMap, ...]:
                for view in training.views:
                    view.image.mul_(0.5)
                if self.broken:
                    raise ValueError("lost")
                size = training.views[0].image.shape[1:]
                far = torch.full(size, 2.0)
                return tuple(DepthMap(far, torch.ones(size)) for _ in training.views)

        preparation.forget()
        yield


def config(**changes: Any) -> dict[str, Any]:
    return small_config(group("depth", "plane_sweep")) | changes


@pytest.mark.parametrize(("name", "choice"), [("reg", "scribbler"), ("depth", "spoiler")])
def test_the_next_run_is_what_it_would_be_alone(tmp_path: Path, name: str, choice: str) -> None:
    alone = run_experiment(config(), tmp_path / "alone", Silent())
    run_experiment(config(**{name: group(name, choice)}), tmp_path / "odd", Silent())
    after = run_experiment(config(), tmp_path / "after", Silent())
    assert after.parameters_sha256 == alone.parameters_sha256
    assert after.summary == alone.summary
