"""Names of scenes among the runs of a study, and which scenes chose the project's defaults.

A result on a scene that chose a default is better than on a new scene (`scenes.csv`). On scenes
that "helped", held-out training photos took part in a choice, and no test photo did. Scenes that
the file lacks are the user's.
"""

import csv
import functools
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from framework.records.record import SceneInfo
from framework.report.study.axes import DATA_KEYS, VIEWS
from framework.report.study.methods import Option, all_keys, differing
from framework.report.study.plugins import with_defaults
from framework.report.study.words import Flat, flatten, outside, value_text
from framework.scenes import ALL

CHOSE, HELPED, TESTS, YOURS = "chose", "helped", "tests", "yours"
MARK = "°"  # after the name of a scene that chose defaults
UNKNOWN_SCENE = "unknown scene"


@dataclass(frozen=True)
class SceneLabel:
    """A scene with the options that distinguish it from others of its name.

    Attributes:
        mark: the start of its fingerprint, where options do not distinguish it.
        data: values of the stresses and conditions (`DATA_KEYS`) that it has.
    """

    name: str
    options: tuple[Option, ...]
    mark: str
    data: Flat

    @property
    def full(self) -> str:
        parts = [*(f"{key}={value}" for key, value in self.options), *filter(None, [self.mark])]
        return f"{self.name} ({', '.join(parts)})" if parts else self.name

    def without(self, option: str) -> str:
        """The label without one of its options."""
        return replace(self, options=tuple(o for o in self.options if o[0] != option)).full


def scene_labels(
    configs: Sequence[Mapping[str, Any]], scenes: Sequence[SceneInfo | None]
) -> list[SceneLabel]:
    """The label of each run's scene.

    Args:
        scenes: None for a run that failed before it was loaded.
    """
    flat = [
        _without_idle_strength(config)
        for config in with_defaults([flatten(config) for config in configs])
    ]
    names = _scene_names(configs, scenes)
    labels: dict[int, SceneLabel] = {}
    for name in set(names):
        alike = [index for index, other in enumerate(names) if other == name]
        result = _distinguished(name, [flat[i] for i in alike], [scenes[i] for i in alike])
        labels |= dict(zip(alike, result, strict=True))
    return [labels[index] for index in range(len(flat))]


def _without_idle_strength(flat: Flat) -> Flat:
    """The strength of no corruption is no condition."""
    if flat.get("depth.corruption") != "none":
        return flat
    return {key: value for key, value in flat.items() if key != "depth.strength"}


def _scene_names(
    configs: Sequence[Mapping[str, Any]], scenes: Sequence[SceneInfo | None]
) -> list[str]:
    """A scene that was not loaded has the name that the same loader and folder gave elsewhere."""
    options = [config.get("scene") or {} for config in configs]
    places = [(entry.get("name", UNKNOWN_SCENE), entry.get("path")) for entry in options]
    labels = {place: info.name for place, info in zip(places, scenes, strict=True) if info}
    pairs = zip(places, scenes, strict=True)
    return [outside(info.name if info else labels.get(at, str(at[0]))) for at, info in pairs]


def _distinguished(
    name: str, alike: Sequence[Flat], scenes: Sequence[SceneInfo | None]
) -> list[SceneLabel]:
    """Labels of the runs `alike`, which all have a scene called `name`."""
    prints = {info.fingerprint for info in scenes if info}
    varying = [key for key in all_keys(alike) if differing(key, alike)]
    keys = [key for key in varying if key in DATA_KEYS]
    if len(prints) > 1:
        keys += [key for key in varying if key.startswith("scene.") and key not in keys]
    named = [
        tuple((k.rpartition(".")[2], value_text(e[k])) for k in sorted(keys) if k in e)
        for e in alike
    ]
    result: dict[tuple[Option, ...], set[str]] = defaultdict(set)
    for options, info in zip(named, scenes, strict=True):
        if info:
            result[options].add(info.fingerprint)
    labels = []
    for options, info, config in zip(named, scenes, alike, strict=True):
        # the fingerprint distinguishes what options do not, such as edited images
        mark = info.fingerprint[:8] if info and len(result[options]) > 1 else ""
        labels.append(SceneLabel(name, options, mark, _data(config, info)))
    return labels


def _data(config: Flat, scene: SceneInfo | None) -> Flat:
    """The stresses and conditions of a configuration; `all` views as their number."""
    data = {key: config[key] for key in DATA_KEYS if key in config}
    if scene is not None and data.get(VIEWS) == ALL:
        data[VIEWS] = len(scene.training)
    return data


def role(name: str) -> str:
    """`CHOSE`, `HELPED`, `TESTS` or `YOURS`, by the name in the scene's record."""
    return _roles().get(name, YOURS)


def marked(label: str, name: str) -> str:
    """Return the scene's label, with `MARK` if this project's defaults were chosen on it."""
    return f"{label} {MARK}" if role(name) == CHOSE else label


@functools.cache
def _roles() -> dict[str, str]:
    file = Path(__file__).with_name("scenes.csv")
    with file.open(encoding="utf-8", newline="") as rows:
        return {row["scene"]: row["role"] for row in csv.DictReader(rows)}
