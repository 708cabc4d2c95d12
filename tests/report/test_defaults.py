"""A record of before an option existed says nothing of it: the option's default counts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest

from framework.records.record import SceneInfo
from framework.report.study import defaults
from framework.report.study.defaults import BEFORE
from framework.report.study.labels import method_labels, scene_labels, text_of
from plugins.augment.safi import Safi
from plugins.regularize.uar import Uar
from tests.record.fakes import make_config


def _names(configs: Sequence[dict[str, Any]]) -> list[str]:
    return [label.full for label in method_labels(configs)]


def test_an_old_record_is_the_method_with_the_default() -> None:
    """It joined every variant before, so that one name was of two methods."""
    old = make_config("safi")
    new, other = (
        old | {"augment": {"name": "safi", "weight": 1.0, "eta": eta}} for eta in (Safi().eta, 9.0)
    )
    assert _names([old, new]) == ["safi + none"] * 2
    of_default, of_other = f"safi + none, augment.eta={Safi().eta}", "safi + none, augment.eta=9.0"
    assert _names([old, new, other]) == [of_default, of_default, of_other]
    assert _names([old, other]) == [of_default, of_other]


def test_one_of_several_regularizers_too() -> None:
    name = "uar+binocular"
    old = make_config() | {"reg": {"name": name, "uar": {}, "binocular": {"weight": 1.0}}}
    new = make_config() | {"reg": {"name": name, "uar": {"p": 0.9}, "binocular": {"weight": 1.0}}}
    assert _names([old, new]) == [f"none + {name}, reg.uar.p={p}" for p in (Uar().p, 0.9)]


def test_a_plugin_that_is_not_known_has_no_default() -> None:
    old = make_config("mine")
    new = old | {"augment": {"name": "mine", "weight": 1.0, "eta": 2.0}}
    assert _names([old, new]) == ["mine + none"] * 2


def test_the_trainer_has_defaults_or_what_it_did_before() -> None:
    old = make_config()
    same, other = (make_config(trainer={**old["trainer"], "visits": visits}) for visits in (0, 4))
    assert _names([old, same]) == ["none + none"] * 2
    assert _names([old, same, other]) == [f"none + none, visits={n}" for n in (0, 0, 4)]
    single = {key: value for key, value in old["trainer"].items() if key != "members"}
    assert _names([old, make_config(trainer=single)]) == ["none + none"] * 2


def test_what_was_done_before_an_option_that_acts_by_default() -> None:
    """A record that lacks it is none of today's default; so of every such option."""
    for (group, plugin), values in BEFORE.items():
        of_group = {"name": plugin} if plugin else {}
        for key, before in values.items():
            old, new, same = (
                make_config() | {group: {**make_config().get(group, {}), **of_group, **more}}
                for more in ({}, {key: 7}, {key: before})
            )
            if key in old[group]:
                del old[group][key]
            names = _names([old, new, same])
            assert names[0] == names[2] != names[1], (group, plugin, key)
            assert f"{key}={text_of(before)}" in names[0], names


def test_a_scene_that_lacks_an_option_is_the_one_with_the_default() -> None:
    """With the same photos it was told apart by the option's default."""
    info = SceneInfo("embedded", "own", "00" * 32, ("a",), ("b",))
    scene = make_config()["scene"]
    configs = [make_config(scene=scene | more) for more in ({}, {"texture": 1.0}, {"texture": 0.2})]
    assert [s.full for s in scene_labels(configs[:2], [info, info])] == ["embedded"] * 2
    told = [label.data["scene.texture"] for label in scene_labels(configs, [info] * 3)]
    assert told == [1.0, 1.0, 0.2]


def test_no_plugin_is_looked_for_where_nothing_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    """It takes time, and a report has to come from records alone."""
    monkeypatch.setattr(defaults, "lookup", lambda *_: 1 / 0)
    assert _names([make_config("safi"), make_config()]) == ["safi + none", "none + none"]
