"""A training over every rasterizer: as with the kernels, with every plugin, from a checkpoint."""

import dataclasses
from collections.abc import Iterator
from functools import partial
from typing import Any

import pytest
import torch

from framework import registry
from framework.backends import NUMBA, Rasterizer
from framework.compute.rng import stream
from framework.options import TrainerOptions
from framework.records.progress import Silent
from framework.run.plane import textured_plane
from framework.run.training import renderer
from framework.train.resume.training_state import Trained, TrainerState
from framework.train.trainer import Plugins, Trainer
from tests.backends.choices import NAMES, STAND_IN, opened

OTHERS = [name for name in NAMES if name != NUMBA.name]
IDLE = {"augment": "none", "reg": "none", "capacity": "fixed"}
SOON = {  # what makes a plugin act within a few steps
    "adc": {"from_step": 1, "every": 2, "grad_threshold": 1e-7},
    "budget": {"budget": 150},
}
registry.discover()
METHODS = [
    {group: name}
    for group in registry.GROUPS
    for name in sorted(registry.table(group))
    if name != IDLE[group]
]


@pytest.fixture(params=OTHERS)
def rasterizer(request: pytest.FixtureRequest) -> Iterator[Rasterizer]:
    yield from opened(request.param)


def plugin(group: str, name: str) -> Any:
    options = {"name": name, "start": 0.0, "stop": 1.0, "weight": 1.0, **SOON.get(name, {})}
    if not registry.lookup(group, name).weighted():
        del options["weight"]
    reference = [row[0] for row in registry.option_fields(registry.lookup(group, name))]
    if "min_coverage" in reference:
        options["min_coverage"] = 0.05
    return registry.build(group, {k: v for k, v in options.items() if k in ("name", *reference)})


def trainer(rasterizer: Rasterizer, steps: int, **inputs: Any) -> Trainer:
    """On three views of a textured plane, 64x48, with 200 Gaussians of SH degree 1."""
    training, depth, gaussians = textured_plane(1)
    draws = torch.from_numpy(stream(0, "test-start").normal(0, 0.4, (len(gaussians), 7))).float()
    gaussians = gaussians.replace(  # a round Gaussian's turn is nothing but rounding
        log_scales=gaussians.log_scales + draws[:, :3], quats=gaussians.quats + draws[:, 3:]
    )
    options = TrainerOptions(steps=steps, evaluations=1, sh_every=3, coarse_until=0.0)
    names = {group: inputs.pop(group, name) for group, name in IDLE.items()}
    plugins = Plugins({group: plugin(group, name) for group, name in names.items()})
    reference = (training, depth, gaussians, options, plugins, 0, Silent())
    return Trainer(*reference, warns=False, rasterizer=rasterizer, **inputs)


def image(trained: Trained) -> torch.Tensor:
    camera = textured_plane(1)[0].views[1].camera
    near = TrainerOptions().near_plane * textured_plane(1)[0].near
    return renderer(trained.gaussians, trained.background, trained.sh_degree, near)(camera)


def test_twenty_steps_end_where_the_kernels_do(rasterizer: Rasterizer) -> None:
    """The loss to 1 %, the image of the middle view to 40 dB."""
    ours, theirs = trainer(NUMBA, 20).run(), trainer(rasterizer, 20).run()
    photo, start = textured_plane(1)[0].views[1].image, trainer(rasterizer, 1).run()
    errors = [(image(t) - photo).square().mean() for t in (start, theirs)]
    assert errors[1] < errors[0], "it trains"
    assert ours.history[-1].loss == pytest.approx(theirs.history[-1].loss, rel=0.01)
    error = (image(ours) - image(theirs)).square().mean()
    assert -10 * error.log10() > 40
    assert all(t.device.type == "cpu" for _, t in theirs.gaussians.items())


@pytest.mark.parametrize("rasterizer", [STAND_IN, "gsplat"], indirect=True)
@pytest.mark.parametrize("method", METHODS, ids=lambda m: "-".join(*m.items()))
def test_every_plugin(rasterizer: Rasterizer, method: dict[str, str]) -> None:
    trained = trainer(rasterizer, 4, **method).run()
    assert len(trained.gaussians) > 0
    assert all(torch.isfinite(t).all() for _, t in trained.gaussians.items())


def test_a_kept_training_goes_on(rasterizer: Rasterizer) -> None:
    """With the parameters, moments and plugins of a checkpoint, to the same end."""

    class Keeper:
        state: TrainerState | None = None
        steps = 0

        def due(self) -> bool:
            self.steps += 1
            return self.steps == 5

        def keep(self, state: TrainerState) -> None:
            params, adam = state.field.gaussians.clone(), state.field.adam
            moments = dataclasses.replace(
                adam, first=adam.first.clone(), second=adam.second.clone()
            )
            field = dataclasses.replace(state.field, gaussians=params, adam=moments)
            self.state = dataclasses.replace(state, field=field)

    keeper, begun = Keeper(), partial(trainer, rasterizer, 9, reg="uar", capacity="evidence")
    whole = begun(keeper=keeper).run()
    assert keeper.state is not None and keeper.state.field.gaussians.means.device.type == "cpu"
    again = begun(start=keeper.state).run()
    close = 0.0 if rasterizer.keeps_bits else 1e-3
    for (_, a), (_, b) in zip(whole.gaussians.items(), again.gaussians.items(), strict=True):
        assert torch.allclose(a, b, rtol=0, atol=close)
