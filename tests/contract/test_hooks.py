"""A mistake in somebody's plugin ends in one line that names the plugin and the hook."""

import dataclasses
from dataclasses import dataclass
from typing import Any, ClassVar

import pytest
import torch

from framework import registry
from framework.errors import UserError
from framework.plugin import Augmenter, Capacity, Edits, Regularizer, register
from framework.run.plane import textured_plane
from framework.train import hooks
from tests.documents.registered import as_before

VIEW = textured_plane(0)[0].views[0]
THREE = textured_plane(0)[2].rows(0, 3)
GRADIENT = torch.zeros((), requires_grad=True)


def plugin(base: type, group: str) -> Any:
    return type("Mine", (base,), {"name": "mine", "group": group})()


@pytest.mark.parametrize(
    ("result", "message"),
    [
        (None, r"expected to return \(list of views, state\), got NoneType"),
        ((VIEW, None), "expected a list of views, got View"),
        (([VIEW.image], None), "view 0: expected a View, got Tensor"),
        (([dataclasses.replace(VIEW, mask=VIEW.image)], None), r"view 0.mask: .* \[48, 64\], got"),
        (([dataclasses.replace(VIEW, image=VIEW.image[:, 1:])], None), r"view 0.image: .*got"),
        (([dataclasses.replace(VIEW, image=VIEW.image * torch.nan)], None), "got NaN"),
        (([dataclasses.replace(VIEW, image=VIEW.image + torch.inf)], None), "got infinity"),
    ],
)
def test_pseudo_views(result: object, message: str) -> None:
    with pytest.raises(UserError, match=rf"^augment=mine: pseudo_views: .*{message}"):
        hooks.pseudo_views(plugin(Augmenter, "augment"), result)


@pytest.mark.parametrize(
    ("result", "message"),
    [
        (torch.ones(3), r"expected to return \(factors or None, state\), got Tensor"),
        ((torch.ones(2), None), r"expected float32 \[3\], got float32 \[2\]"),
        ((0.5, None), "got float"),
        ((torch.tensor([1.0, -0.1, 1.0]), None), "expected finite numbers >= 0"),
    ],
)
def test_opacity_factors(result: object, message: str) -> None:
    with pytest.raises(UserError, match=rf"^reg=mine: opacity_factors: .*{message}"):
        hooks.opacity_factors(plugin(Regularizer, "reg"), result, 3)


@pytest.mark.parametrize(
    ("term", "message"),
    [
        (0.5, "expected a scalar tensor, got float"),
        (torch.ones(2, 3), r"expected a scalar tensor, got Tensor \[2, 3\]"),
        (torch.ones(()), "without a gradient"),
        (GRADIENT * torch.nan, "expected a finite number, got nan"),
    ],
)
def test_loss_term(term: object, message: str) -> None:
    with pytest.raises(UserError, match=rf"^reg=mine: loss: .*{message}"):
        hooks.loss_term(plugin(Regularizer, "reg"), term)


def test_edits() -> None:
    mine = plugin(Capacity, "capacity")
    with pytest.raises(UserError, match=r"^capacity=mine: update: expected to return \(Edits or"):
        hooks.edits(mine, Edits(), THREE)
    with pytest.raises(UserError, match="expected Edits or None, got Tensor"):
        hooks.edits(mine, (torch.ones(3), None), THREE)
    whole, true = torch.ones(3, dtype=torch.int64), torch.ones(3, dtype=torch.bool)
    for part, value in (
        ("keep", true[:2]),
        ("keep", [True] * 3),
        ("bands", whole),
        ("sh0", torch.zeros(3, 3)),
    ):
        with pytest.raises(UserError, match=f"^capacity=mine: update: `{part}`: expected "):
            hooks.edits(mine, (Edits(**{part: value}), None), THREE)
    with pytest.raises(UserError, match=r"update: `means`: expected float32 \[3, 3\]"):
        hooks.edits(mine, (Edits(values={"means": torch.zeros(2, 3)}), None), THREE)
    with pytest.raises(UserError, match="update: expected parameters in `values`, got 'colour'"):
        hooks.edits(mine, (Edits(values={"colour": torch.zeros(3)}), None), THREE)
    endless = torch.full((3,), -torch.inf)
    with pytest.raises(UserError, match="`sh0`: expected finite numbers, got infinity"):
        hooks.edits(mine, (Edits(sh0=torch.full((3, 1, 3), torch.inf)), None), THREE)
    with pytest.raises(UserError, match="`opacity_logits`: expected finite numbers, got infinity"):
        hooks.edits(mine, (Edits(values={"opacity_logits": endless}), None), THREE)


def test_what_a_capacity_adds_fits_what_there_is() -> None:
    mine = plugin(Capacity, "capacity")
    for name, value, message in (
        (
            "means",
            THREE.means.double(),
            r"float32 \[3, 3\] in `append.means`, got float64 \[3, 3\]",
        ),
        ("quats", THREE.quats[:2], r"float32 \[3, 4\] in `append.quats`, got float32 \[2, 4\]"),
        ("shN", torch.zeros(3, 3, 3), r"in `append.shN`, got float32 \[3, 3, 3\]"),
    ):
        odd = THREE.replace(**{name: value})
        with pytest.raises(UserError, match=f"^capacity=mine: update: expected .*{message}"):
            hooks.edits(mine, (Edits(append=odd), None), THREE)
    with pytest.raises(UserError, match="expected Gaussians in `append`, got list"):
        hooks.edits(mine, (Edits(append=[]), None), THREE)  # type: ignore[arg-type]
    assert hooks.edits(mine, (Edits(append=THREE.rows(0, 0)), 1), THREE)[1] == 1


def test_the_gradients_that_a_capacity_asks_for() -> None:
    mine = plugin(Capacity, "capacity")
    assert hooks.requested_gradients(mine) == ()
    for names in (("opacities",), "opacity_logits", ("means", "colour"), None):
        asking = plugin(Capacity, "capacity")
        object.__setattr__(asking, "gradients", names)
        with pytest.raises(UserError, match=r"^capacity=mine: gradients: expected a tuple of some"):
            hooks.requested_gradients(asking)


def test_a_step_of_its_own_and_another_gradient() -> None:
    mine, loss = plugin(Regularizer, "reg"), GRADIENT
    assert hooks.sub_step(mine, (loss, ("means",))) == (loss, ("means",))
    with pytest.raises(UserError, match=r"^reg=mine: substeps: expected to return \(loss, names"):
        hooks.sub_step(mine, loss)
    with pytest.raises(UserError, match=r"^reg=mine: substeps: expected some of means, quats"):
        hooks.sub_step(mine, (loss, ("colour",)))
    with pytest.raises(UserError, match=r"substeps: expected a scalar loss of ctx.gaussians"):
        hooks.sub_step(mine, (torch.zeros(()), ("means",)))
    actual = {"means": torch.zeros(3, 3)}
    assert hooks.gradient(mine, actual, actual) is actual
    with pytest.raises(UserError, match="gradient: expected means, got"):
        hooks.gradient(mine, {}, actual)
    with pytest.raises(UserError, match="gradient: `means`: expected float32"):
        hooks.gradient(mine, {"means": torch.zeros(2, 3)}, actual)
    assert hooks.evaluated(mine, THREE, THREE.shN.shape[1]) is THREE
    with pytest.raises(UserError, match="evaluated: the Gaussians: expected Gaussians, got int"):
        hooks.evaluated(mine, 3, 0)


def test_a_class_that_is_no_plugin_is_told_at_its_definition() -> None:
    class Bare(Regularizer):
        pass

    @dataclass
    class Thawed(Regularizer):
        pass

    @dataclass(frozen=True)
    class Weighted(Regularizer):
        weight: float = 0.5

    @dataclass(frozen=True)
    class Untyped(Regularizer):
        defaults: ClassVar[dict[str, float]] = {"start": 0.1}
        strength = 0.5

    @dataclass(frozen=True)
    class Hookless(Regularizer):
        pass

    @dataclass(frozen=True)
    class Other(Augmenter):
        pass

    @dataclass(frozen=True)
    class Slip(Regularizer):
        defaults: ClassVar[dict[str, float]] = {"wieght": 0.1}

    for cls, message in (
        (Hookless, "expected one of opacity_factors, loss, "),
        (Other, "expected a class derived from framework.plugin.Regularizer"),
        (Slip, "finite numbers for weight, start, stop, got {'wieght': 0.1}"),
        (Bare, "frozen dataclass"),
        (Thawed, "frozen dataclass"),
        (Weighted, "got a field 'weight'"),
        (Untyped, "write 'strength: float = 0.5'"),
    ):
        with pytest.raises(UserError, match=rf"^reg=bad \(.*{cls.__name__}\): .*{message}"):
            register("reg", "bad")(cls)
    for name in ("a+b", "a/b", "1", "Mine", "null"):
        with pytest.raises(UserError, match="expected a name of lower-case letters"):
            register("reg", name)(Hookless)
    with pytest.raises(UserError, match="expected the method `pseudo_views`, got none"):
        register("augment", "bad")(Other)
    assert "bad" not in (*registry.table("reg"), *registry.table("augment"))


def test_what_a_plugin_s_own_checks_raise_names_it() -> None:
    @dataclass(frozen=True)
    class Picky(Regularizer):
        k: int = 1

        def __post_init__(self) -> None:
            super().__post_init__()  # type: ignore[misc]

        def loss(self, *_: Any) -> None: ...

    with as_before():
        register("reg", "picky")(Picky)
        with pytest.raises(UserError, match=r"^reg=picky: raised AttributeError: .*__post_init__"):
            registry.build("reg", {"name": "picky"})
