"""Mistakes in a plugin end in one line that names it, whatever they are."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
import torch

from framework import registry
from framework.errors import PluginError, UserError, plugin_call
from framework.files.paths import OWN_VARIABLE, own_plugins
from framework.metrics.evaluate import plugged as measured
from framework.metrics.values import LARGEST, Missing
from framework.plugin import Capacity, Edits, Regularizer
from framework.records.record import read_run
from framework.records.run_files import HistoryRow, history_csv
from framework.registry import ActivePlugin
from framework.run import answers
from framework.train.dose import Dose, summary
from tests.contract.test_hooks import as_before
from tests.golden.test_contracts import trainer
from tests.record.fakes import fake_run


def reg(**hooks: Callable[..., Any]) -> Any:
    """A regularizer with these hooks, as from a user's folder."""
    return type("Mine", (Regularizer,), {"name": "mine", **hooks})()


def write(array: np.ndarray) -> None:
    array[...] += 0.01


def in_place(_: Any, ctx: Any, *rest: Any) -> Any:
    write(ctx.gaussians.means.detach().numpy())


def picture_in_place(_: Any, ctx: Any, state: Any, view: Any, render: Any) -> Any:
    render.rgb[0].mul_(0.5)
    return render.rgb.mean()


def picture_by_numpy(_: Any, ctx: Any, state: Any, view: Any, render: Any) -> Any:
    write(render.rgb.detach().numpy())
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


def infinite(_: Any, ctx: Any, gaussians: Any, state: Any) -> Any:
    return gaussians.replace(log_scales=gaussians.log_scales + math.inf)


def nothing(_: Any, ctx: Any, gaussians: Any, state: Any) -> Any:
    return gaussians.map(lambda tensor: tensor[:0]) if hasattr(gaussians, "map") else None


@pytest.mark.parametrize(
    ("hook", "method", "expected"),
    [
        ("loss", in_place, "ctx.gaussians.means unchanged"),
        ("init_state", in_place, "ctx.gaussians.means unchanged"),
        ("loss", picture_in_place, "render.rgb unchanged"),
        ("loss", picture_by_numpy, "render.rgb unchanged"),
        ("loss", backward, r"called backward\(\)"),
        ("loss", leave, r"called sys.exit\(0\) \(test_mistakes.py:\d+\)"),
        ("substeps", endless, "gave more than 1000 losses in step 0"),
        ("substeps", lambda *_: [[1]], "expected to return"),
        ("substeps", lambda _, ctx, *r: iter([(ctx.gaussians.sh0.sum(), [[1]])]), "expected some"),
        ("substeps", lambda *_: 3, "raised TypeError"),
        ("gradient", lambda *_: 3, "expected means, .*, got int"),
        ("evaluated", not_a_number, "expected numbers, got NaN"),
        ("evaluated", infinite, "expected finite numbers, got infinity"),
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


def test_values_that_are_no_mapping() -> None:
    mine = type("Mine", (Capacity,), {"name": "mine", "update": lambda *_: (Edits(values=[1]), 0)})
    with pytest.raises(PluginError, match=r"^capacity=mine: update: what it returns: raised"):
        trainer(capacity=ActivePlugin(mine())).run()


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
        ("raise SystemExit", r"x.py: importing it: called sys.exit\(\)"),
        (define("a: Undefined = 3"), "name 'Undefined' is not defined"),
        (define("defaults: ClassVar[dict] = {'weight': 'x'}"), "must be a finite number, got 'x'"),
        (define("defaults: ClassVar[dict] = {'stop': float('nan')}"), "must be a finite number"),
        (define("defaults: ClassVar[dict] = 3"), "`defaults` must be a dict"),
        (define("def __post_init__(self): raise SystemExit(0)"), r"called sys.exit\(0\)"),
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
    with (
        pytest.raises(PluginError, match=r"^init=mine: build: raised ValueError: no start \(test_"),
        answers.called("init=mine: build", type("Mine", (), {})),
    ):
        raise ValueError("no start")


def test_what_the_machine_lacks_is_not_the_plugin_s_fault() -> None:
    with pytest.raises(MemoryError), plugin_call("reg=mine"):
        raise MemoryError


def test_only_regular_files_with_names_in_utf8_are_plugins(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import os

    os.mkfifo(tmp_path / "pipe.py")
    (tmp_path / "a.py").touch()
    monkeypatch.setenv(OWN_VARIABLE, str(tmp_path))
    assert [place for place, _ in own_plugins()] == ["a.py"]
    folder = os.fsencode(tmp_path) + b"/\xff"
    os.mkdir(folder)
    open(folder + b"/b.py", "w").close()
    with pytest.raises(UserError, match="not UTF-8"):
        own_plugins()


@dataclass(frozen=True)
class Huge:
    value: float
    name: ClassVar[str] = "huge"

    def measure(self, *_: Any) -> float:
        if math.isnan(self.value):
            sys.exit(0)
        return self.value


@pytest.mark.parametrize("value", [1e308, -1e16, math.nan])
def test_a_metric_beyond_what_is_read_is_missing(value: float) -> None:
    image = np.zeros((4, 4, 3), np.uint8)
    assert isinstance(measured("huge", Huge(value), image, image, None), Missing)


def test_numbers_beyond_what_is_read_are_not_written(tmp_path: Path) -> None:
    dose = Dose()
    dose.open("reg.asked")
    dose.add("log.reg.x", 1e300)
    assert summary(dose.kept())["x_mean"] == f"beyond {LARGEST:g}"
    path = fake_run(tmp_path)
    row = HistoryRow(1, 0.1, 1e300, 5, 0, logged={"x": 1e300})
    (path / "history.csv").write_text(history_csv([row]))
    assert math.isnan(read_run(path).history.numbers["loss"][0])


@pytest.mark.parametrize(("name", "value"), [("a\nb", 1.0), (3, 1.0), ("x", "text")])
def test_what_cannot_be_logged(name: Any, value: Any) -> None:
    def loss(_: Any, ctx: Any, state: Any, view: Any, render: Any) -> Any:
        ctx.log(name, value)

    with pytest.raises(UserError, match=r"loss, step 0: raised|ctx.log: expected a name"):
        trainer(reg=ActivePlugin(reg(loss=loss))).run()


def test_a_number_that_torch_made_is_logged_as_one() -> None:
    def loss(_: Any, ctx: Any, state: Any, view: Any, render: Any) -> Any:
        ctx.log("x", torch.tensor(2.0))

    row = trainer(reg=ActivePlugin(reg(loss=loss))).run().history[-1]
    assert row.logged == {"x": 2.0}
