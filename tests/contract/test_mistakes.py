"""Mistakes in a plugin end in one line that names it, whatever they are."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from framework import registry
from framework.errors import PluginError, UserError
from framework.files.paths import OWN_VARIABLE
from framework.plugin import Capacity, Edits, Regularizer
from framework.registry import ActivePlugin
from framework.run import answers
from tests.documents.registered import as_before
from tests.golden.test_contracts import trainer


def reg(**hooks: Callable[..., Any]) -> Any:
    """A regularizer with these hooks, as from a user's folder."""
    return type("Mine", (Regularizer,), {"name": "mine", **hooks})()


def write(array: np.ndarray) -> None:
    array[...] += 0.01


def in_place(_: Any, ctx: Any, *rest: Any) -> Any:
    write(ctx.gaussians.means.detach().numpy())


def steps_in_place(_: Any, ctx: Any, *rest: Any) -> Any:
    yield ctx.gaussians.sh0.sum(), ("sh0",)
    write(ctx.gaussians.means.detach().numpy())


def failing(*_: Any) -> Any:
    raise ValueError("lost")


def picture_in_place(_: Any, ctx: Any, state: Any, view: Any, render: Any) -> Any:
    render.rgb[0].mul_(0.5)
    return render.rgb.mean()


def backward(_: Any, ctx: Any, state: Any, view: Any, render: Any) -> Any:
    loss = render.rgb.mean()
    loss.backward()
    return loss


def endless(_: Any, ctx: Any, *rest: Any) -> Any:
    while True:
        yield 0 * ctx.gaussians.means.sum(), ("means",)


def leave(*_: Any) -> Any:
    sys.exit(0)


def not_a_number(_: Any, ctx: Any, gaussians: Any, state: Any) -> Any:
    return gaussians.replace(means=gaussians.means * math.nan)


def nothing(_: Any, ctx: Any, gaussians: Any, state: Any) -> Any:
    return gaussians.map(lambda tensor: tensor[:0]) if hasattr(gaussians, "map") else None


@pytest.mark.parametrize(
    ("hook", "method", "expected"),
    [
        ("loss", in_place, "ctx.gaussians.means unchanged"),
        ("init_state", in_place, "ctx.gaussians.means unchanged"),
        ("opacity_factors", in_place, "ctx.gaussians.means unchanged"),
        ("gradient", in_place, "ctx.gaussians.means unchanged"),
        ("substeps", steps_in_place, "step 0: expected ctx.gaussians.means unchanged"),
        ("opacity_factors", failing, "step 0: raised ValueError: lost"),
        ("evaluated", failing, "step 3: raised ValueError: lost"),
        ("loss", picture_in_place, "render.rgb unchanged"),
        ("loss", backward, r"called backward\(\)"),
        ("loss", leave, r"called sys.exit\(0\) \(test_mistakes.py:\d+\)"),
        ("substeps", endless, "gave more than 1000 losses in step 0"),
        ("substeps", lambda _, ctx, *r: iter([(ctx.gaussians.sh0.sum(), [[1]])]), "expected some"),
        ("gradient", lambda *_: 3, "expected means, .*, got int"),
        ("evaluated", not_a_number, "expected numbers, got NaN"),
        ("evaluated", nothing, "expected "),
    ],
)
def test_a_regularizer(hook: str, method: Callable[..., Any], expected: str) -> None:
    hooks = {hook: method}
    if hook in ("init_state", "evaluated"):
        hooks["loss"] = lambda _, ctx, state, view, render: render.rgb.mean()
    with pytest.raises(UserError, match=rf"^reg=mine: {hook}.*{expected}"):
        trainer(reg=ActivePlugin(reg(**hooks))).run()


@pytest.mark.parametrize("ceiling", [0.0, 1.0, 2.0, -1, math.nan, "x", True])
def test_a_ceiling_of_opacities(ceiling: Any) -> None:
    def update(*_: Any) -> Any:
        return Edits(opacity_ceiling=ceiling), None

    mine = type("Mine", (Capacity,), {"name": "mine", "update": update})()
    with pytest.raises(UserError, match=r"^capacity=mine: update: expected an `opacity_ceiling`"):
        trainer(capacity=ActivePlugin(mine)).run()


def define(body: str) -> str:
    return f"""
from __future__ import annotations
from dataclasses import dataclass
from typing import ClassVar
from framework.plugin import Regularizer, register

@register("reg", "mine")
@dataclass(frozen=True)
class Mine(Regularizer):
    {body}

    def loss(self, *_):
        return None
"""


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ("import sys; sys.exit(0)", r"x.py: importing it: called sys.exit\(0\)"),
        (define("a: Undefined = 3"), "name 'Undefined' is not defined"),
        (
            define("defaults: ClassVar[dict] = {'weight': 'x'}"),
            "finite numbers .* got {'weight': 'x'}",
        ),
        (define("defaults: ClassVar[dict] = 3"), "`defaults` must be a dict"),
        (define("def check_span(self, *_): raise SystemExit(0)"), "reg=mine: check_span: called"),
    ],
)
def test_a_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, source: str, expected: str
) -> None:
    (tmp_path / "x.py").write_text(source)
    with as_before():
        monkeypatch.setenv(OWN_VARIABLE, str(tmp_path))
        with pytest.raises(UserError, match=expected):
            registry.build("reg", {"name": "mine"})
        monkeypatch.delenv(OWN_VARIABLE)


def test_a_start_that_raises_is_named() -> None:
    with pytest.raises(
        PluginError, match=r"^init=mine: build: raised ValueError: no start \(test_"
    ):
        answers.ask("init=mine: build", Path(), no_start, print)


def no_start() -> None:
    raise ValueError("no start")


@pytest.mark.parametrize(("name", "value"), [("a\nb", 1.0), (3, 1.0), ("x", "text")])
def test_what_cannot_be_logged(name: Any, value: Any) -> None:
    def loss(_: Any, ctx: Any, state: Any, view: Any, render: Any) -> Any:
        ctx.log(name, value)

    with pytest.raises(UserError, match=r"loss, step 0: raised|ctx.log: expected a name"):
        trainer(reg=ActivePlugin(reg(loss=loss))).run()


def test_values_that_are_no_mapping() -> None:
    mine = type("Mine", (Capacity,), {"name": "mine", "update": lambda *_: (Edits(values=[1]), 0)})
    with pytest.raises(PluginError, match=r"^capacity=mine: update: what it returns: raised"):
        trainer(capacity=ActivePlugin(mine())).run()
