"""What every scene loader, depth provider, initializer and metric must do, whoever wrote it: the
project's own, those in `plugins/`, and the examples of the tutorial."""

import dataclasses
import functools
import importlib.util
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import torch

from framework import registry
from framework.command.config.schema import OBJECT_GROUPS, ROOT, choices, rows
from framework.errors import UserError
from framework.metrics.evaluate import plugged
from framework.metrics.values import Missing
from framework.options import TrainerOptions
from framework.plugin import DepthProvider, Initializer, Metric
from framework.run import answers
from framework.run.plane import textured_plane
from framework.run.training import initial
from framework.shapes import check_gaussians
from framework.types import Gaussians, Scene
from tests.documents.pages import blocks
from tests.documents.registered import as_before

EXAMPLES = {
    Path(block.title).stem: block.text
    for block in blocks(ROOT / "docs" / "tutorials" / "plugins.md")
    if block.title
}
PARTS = {"scene": "checker", "depth": "flat", "init": "sprinkle", "metric": "edges"}
OWN = [(group, name) for group in registry.PARTS for name in registry.table(group)]
ALL = [*OWN, *PARTS.items()]


@pytest.fixture(autouse=True)
def examples() -> Iterator[None]:
    """The tutorial's examples are registered; afterwards nothing of it is left."""
    with as_before():
        for group, name in PARTS.items():
            registry.table(group)[name] = loaded(name)
        yield


def loaded(name: str) -> type:
    """The class that the tutorial's file `name` registers."""
    module = made(name)
    return next(
        cls for cls in vars(module).values() if getattr(cls, "__module__", "") == module.__name__
    )


def made(name: str) -> ModuleType:
    spec = importlib.util.spec_from_loader(f"examples_{name}", loader=None)
    assert spec is not None
    module = sys.modules[f"examples_{name}"] = importlib.util.module_from_spec(spec)
    exec(compile(EXAMPLES[name], name, "exec"), vars(module))
    return module


def from_defaults(group: str, name: str) -> Any:
    """The part with its defaults; skips one that needs files or a package."""
    cls = registry.table(group)[name]
    fields = registry.plain_fields(cls)
    if any(f.name == "path" or f.default is dataclasses.MISSING for _, _, f in fields):
        pytest.skip(f"{group}={name} needs an option: a folder of files")
    if name == "depth_anything_3":
        pytest.skip("needs a package and weights; tests/depth has its own")
    return cls()


def tensors_of(value: Any) -> list[torch.Tensor]:
    return [part for part in vars(value).values() if isinstance(part, torch.Tensor)]


@pytest.mark.parametrize(("group", "name"), ALL)
def test_it_is_frozen_documented_and_typed(group: str, name: str) -> None:
    cls: Any = registry.table(group)[name]
    assert cls.__dataclass_params__.frozen
    assert cls.__doc__ and not cls.__doc__.startswith(f"{cls.__name__}(")
    assert all(kind is not None for _, kind, _ in registry.plain_fields(cls))
    assert "name" not in {field.name for field in dataclasses.fields(cls)}


@pytest.mark.parametrize(("group", "name"), [pair for pair in ALL if pair[0] in OBJECT_GROUPS])
def test_it_is_a_choice(group: str, name: str) -> None:
    assert name in choices(group)
    rows(group, name)


@pytest.mark.parametrize("name", [name for group, name in ALL if group == "scene"])
def test_a_scene_loads_the_same_twice(name: str) -> None:
    loader = from_defaults("scene", name)
    first, second = loader.load(), loader.load()
    assert first.fingerprint == second.fingerprint
    answers.check_scene(first)


@pytest.mark.parametrize("name", [name for group, name in ALL if group == "depth"])
def test_depth_is_a_map_per_view_the_same_twice(name: str) -> None:
    provider, (training, maps, _) = from_defaults("depth", name), textured_plane(0)
    if name == "ground_truth":
        pytest.skip("needs a scene with exact depth; tests/depth has its own")
    before = [view.image.clone() for view in training.views]
    first, second = provider.estimate(training), provider.estimate(training)
    answers.check_depth(first, training)
    assert len(first) == len(maps)
    for one, other in zip(first, second, strict=True):
        assert torch.equal(one.depth, other.depth)
        assert float(one.confidence.min()) >= 0 and float(one.confidence.max()) <= 1
    assert all(map(torch.equal, before, [view.image for view in training.views]))
    assert isinstance(provider.fingerprint(training), str)


@pytest.mark.parametrize("name", [name for group, name in ALL if group == "init"])
def test_the_first_gaussians_come_of_their_seed_alone(name: str) -> None:
    degree = 1
    builder, (training, maps, _) = from_defaults("init", name), textured_plane(0)
    before = [one.depth.clone() for one in maps]
    first, second = (builder.build(training, maps, degree, 3) for _ in range(2))
    assert isinstance(first, Gaussians) and first.sh_degree == degree
    check_gaussians(name, first, None, (degree + 1) ** 2 - 1)
    assert all(map(torch.equal, tensors_of(first), tensors_of(second)))
    assert all(map(torch.equal, before, [one.depth for one in maps]))


@pytest.mark.parametrize("name", [name for group, name in ALL if group == "metric"])
def test_a_metric_measures_and_changes_nothing(name: str) -> None:
    metric = from_defaults("metric", name)
    render, truth = torch.rand(2, 3, 24, 32, generator=torch.Generator().manual_seed(1))
    mask = torch.ones(24, 32, dtype=torch.bool)
    kept = render.clone(), truth.clone()
    for valid in (None, mask):
        assert metric.measure(render, truth, valid) == metric.measure(render, truth, valid)
        assert float(metric.measure(render, truth, valid)) == pytest.approx(
            float(metric.measure(*kept, valid))
        )
    assert torch.equal(render, kept[0]) and torch.equal(truth, kept[1])


def test_a_metric_that_fails_costs_no_training() -> None:
    class Broken:
        def measure(self, *_: object) -> float:
            raise RuntimeError("two\nlines")

    class Endless:
        def measure(self, *_: object) -> float:
            return float("inf")

    image = (textured_plane(0)[0].views[0].image.permute(1, 2, 0).numpy() * 255).astype("uint8")
    assert plugged("odd", Broken(), image, image, None) == Missing(
        "odd raised RuntimeError: two; lines"
    )
    assert plugged("odd", Endless(), image, image, None) == Missing("odd gave no finite value")


def test_wrong_answers_name_their_plugin() -> None:
    training, maps, _ = textured_plane(0)
    check_depth = functools.partial(answers.check_depth, training=training)
    with pytest.raises(UserError, match=r"^depth=odd: measure: expected a map for each of 3"):
        answers.ask("depth=odd: measure", Path(), lambda: maps[:2], check_depth)
    for part, value, message in (
        ("depth", -1.0, "expected finite numbers >= 0"),
        ("depth", torch.inf, "expected finite numbers >= 0"),
        ("confidence", 100.0, r"expected numbers in \[0, 1\]"),
    ):
        odd = dataclasses.replace(maps[0], **{part: torch.full_like(maps[0].depth, value)})
        with pytest.raises(UserError, match=rf"^depth=odd: measure: the {part} of .*: {message}"):
            wrong = (odd, *maps[1:])
            answers.ask("depth=odd: measure", Path(), lambda wrong=wrong: wrong, check_depth)
    bare = Scene("mine", "rig", training, (), "")
    with pytest.raises(UserError, match=r"^scene=odd: load: the scene's fingerprint: expected a t"):
        answers.ask("scene=odd: load", Path(), lambda: bare, answers.check_scene)
    with pytest.raises(UserError, match=r"^scene=odd: load: the scene: expected Scene, got int"):
        answers.ask("scene=odd: load", Path(), lambda: 3, answers.check_scene)


def test_wrong_gaussians_name_their_initializer(monkeypatch: pytest.MonkeyPatch) -> None:
    @dataclass(frozen=True)
    class Odd(Initializer):
        """Ignores the SH degree."""

        def build(self, *_: Any) -> Gaussians:
            return textured_plane(0)[2]

    monkeypatch.setitem(registry.table("init"), "odd", Odd)
    training, maps, _ = textured_plane(0)
    scene = Scene("mine", "rig", training, (), "x")
    options = TrainerOptions(sh_degree=1)
    with pytest.raises(UserError, match=r"^init=odd: build: the Gaussians\.shN: expected float32"):
        initial({"init": {"name": "odd"}}, scene, maps, options, 0)


def test_what_cannot_be_a_part_is_refused() -> None:
    @dataclass(frozen=True)
    class Needy(Metric):
        """needs: something."""

        needs: int

        def measure(self, *_: Any) -> float:
            return 0.0

    @dataclass(frozen=True)
    class Taken(DepthProvider):
        """Its name is taken."""

        def measure(self, training: Any) -> Any:
            return ()

    for group, name, cls, message in [
        ("init", "mine", Taken, "derived from framework.plugin.Initializer"),
        ("metric", "needy", Needy, "expected a default for 'needs'"),
        ("metric", "psnr", Needy, "expected another name"),
        ("depth", "file", Taken, "two plugins claim this name"),
        ("depht", "own", Taken, "unknown group depht; did you mean 'depth'"),
    ]:
        with pytest.raises(UserError, match=message):
            registry.register(group, name)(cls)
