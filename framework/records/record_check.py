"""Check that a `record.json`, a `failed.json` and their tables are what a run writes. They may come
from elsewhere, and a report formats, sorts and opens files by their content.

Texts are whole and of bounded length already (`framework.files.documents`). Numbers are small
enough for the report's sums of squares to be finite.
"""

import re
import typing
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from framework.metrics.values import LARGEST
from framework.options import TrainerOptions

STEM = re.compile(r"[A-Za-z0-9_-][A-Za-z0-9._-]{0,199}")  # as `run_files.file_stems` writes them
TAGS = re.compile(r"[A-Za-z0-9_-]{0,40}( [A-Za-z0-9_-]{1,40}){0,8}")
NAME_LENGTH = 255  # of a scene or a choice: as of a folder
GROUPS = ("scene", "depth", "init", "augment", "reg", "capacity", "rasterizer")
FACTS = ("fishersplat", "python", "code", "cpu", "system", "bits", "gpu", "cuda", "gsplat")
TRAINER = typing.get_type_hints(TrainerOptions)
EACH = "each"  # the rule of every key of a mapping
Test = Callable[[Any], object]  # whether a value is as a run writes it
Rule = Test | Mapping[str, Any]  # or the rules of a mapping's fields


def check_record(content: Any) -> None:
    """Raise ValueError, naming the field, unless every field that is read has its type."""
    _check_rule("the record", content, RECORD_RULES)
    if content["scene"] is not None:
        _check_rule("scene", content["scene"], SCENE_RULES)
    check_config(content["config"], complete=content["status"] == "complete")
    _check("config.seed", content["config"].get("seed"), "seed" in content["config"])


def check_failure(content: Any) -> None:
    """Check a `failed.json` in the same way."""
    _check_rule("the content", content, FAILURE_RULES)


def check_config(config: Any, complete: bool) -> None:
    """Check a run's configuration in the same way; a failed run's may lack parts."""
    _check("config", config, isinstance(config, Mapping))
    if "seed" in config:
        _check("config.seed", config["seed"], _is_count(config["seed"]))
    for group in GROUPS:
        options = config.get(group)
        named = isinstance(options, Mapping) and _is_name(options.get("name"))
        optional = options is None and not (complete and group == "scene")
        _check(f"config.{group}", options, named or optional)
    for group, options in config.items():
        _check_options(f"config.{group}", options)
    path = (config.get("scene") or {}).get("path")
    _check("config.scene.path", path, path is None or _is_text(path))
    trainer = config.get("trainer", None if complete else {})
    _check("config.trainer", trainer, isinstance(trainer, Mapping))
    for name, value in trainer.items():
        _check(f"config.trainer.{name}", value, _fits(value, TRAINER.get(name)))
    _check("config.trainer.members", trainer, _is_count(trainer.get("members", 1)))


def check_columns(got: Sequence[str], needed: Iterable[str]) -> None:
    """Raise ValueError unless a table's columns are distinct and the needed ones are there."""
    missing = [name for name in needed if name not in got]
    _check("columns", [name[:40] for name in got[:20]], not missing and len(set(got)) == len(got))


def check_stems(stems: Iterable[str]) -> None:
    """Raise ValueError unless these name files in a folder, and nothing outside of it."""
    _check_all("file", stems, STEM.fullmatch)


def check_views(views: Iterable[str], tags: Iterable[str]) -> None:
    """Raise ValueError unless these are names of views and words for their kind."""
    _check_all("view", views, _is_name)
    _check_all("tags", tags, TAGS.fullmatch)


def check_number(name: str, value: float) -> None:
    """Raise ValueError unless `value` is a finite number that can be squared and summed."""
    _check(name, value, abs(value) <= LARGEST)  # false for NaN


def are_texts(value: Any) -> bool:
    """Whether it is a list of texts."""
    return isinstance(value, list) and all(map(_is_text, value))


def _check(name: str, value: Any, good: object) -> None:
    if not good:
        raise ValueError(f"{name[:60]} is {' '.join(str(value)[:200].split())[:60]!r}")


def _check_all(name: str, values: Iterable[str], good: Test) -> None:
    for value in values:
        _check(name, value, good(value))


def _check_rule(where: str, value: Any, rule: Rule) -> None:
    """Check a value, and the fields of a mapping; one that is absent counts as None."""
    if callable(rule):
        _check(where, value, rule(value))
        return
    _check(where, value, isinstance(value, Mapping))
    prefix = "" if where.startswith("the ") else f"{where}."
    for key, inner in rule.items():
        for name in value if key == EACH else [key]:
            _check(where, name, _is_name(name))
            _check_rule(f"{prefix}{name}", value.get(name), inner)


def _check_options(where: str, options: Any) -> None:
    """Check that options are values, in a group of several plugins those of each."""
    if not isinstance(options, Mapping):
        _check(where, options, _is_plain(options))
        return
    parts = str(options.get("name", "")).split("+")
    for name, value in options.items():
        if isinstance(value, Mapping) and len(parts) > 1 and name in parts:
            _check_options(f"{where}.{name}", value)
        else:
            _check(f"{where}.{name}", value, _is_plain(value))


def _is_plain(value: Any) -> bool:
    """Return whether it is a value of an option, or a list of them."""
    values = value if isinstance(value, list) else [value]
    return all(one is None or isinstance(one, bool | int | float | str) for one in values)


def _fits(value: Any, declared: Any) -> bool:
    """Return whether a value has the declared type of a trainer's option; any, without one."""
    if declared in (None, Any):
        return True
    kinds = typing.get_args(declared) or (declared,)
    kinds = (*kinds, int) if float in kinds else kinds
    return type(value) in kinds and (type(value) is not int or abs(value) < 2**63)


def _is_text(value: Any) -> bool:
    return isinstance(value, str)


def _is_count(value: Any) -> bool:
    return type(value) is int and 0 <= value < 2**63


def _is_number(value: Any) -> bool:
    return type(value) in (int, float) and abs(value) <= LARGEST


def _is_line(value: Any) -> bool:
    return _is_text(value) and "\n" not in value


def _is_name(value: Any) -> bool:
    return _is_line(value) and 0 < len(value) <= NAME_LENGTH and value.strip() != ""


def _is_dose(value: Any) -> bool:
    return value is None or isinstance(value, bool) or _is_line(value) or _is_number(value)


def _is_measurement(value: Any) -> bool:
    """Return whether it has a mean, or the reason why there is none."""
    if not isinstance(value, Mapping):
        return False
    return _is_text(value["missing"]) if value["mean"] is None else _is_number(value["mean"])


def _is_git_state(value: Any) -> bool:
    return isinstance(value, Mapping) and _is_text(value["sha"]) and "dirty" in value


def _is_timing(value: Any) -> bool:
    seconds = value["wall_s"], value["cpu_s"]
    return _is_text(value["stage"]) and all(_is_number(s) and s >= 0 for s in seconds)


def _optional(good: Test) -> Test:
    return lambda value: value is None or good(value)


def _mapping_to(good: Test) -> Test:
    return lambda value: isinstance(value, Mapping) and all(map(good, value.values()))


def _matching(pattern: str) -> Test:
    return lambda value: _is_text(value) and re.fullmatch(pattern, value)


SCENE_RULES: Rule = {
    **dict.fromkeys(("name", "protocol", "fingerprint"), _is_name),
    **dict.fromkeys(("training", "test"), are_texts),
}
RECORD_RULES: Rule = {
    "identity": _is_text,
    "parameters_sha256": _matching(r"[0-9a-f]{0,64}"),
    "status": lambda value: value in ("complete", "failed"),
    "peak_memory_bytes": _is_count,
    "gaussians": _is_count,
    "sh_degree": lambda value: _is_count(value) and value <= 10,
    "banded": _optional(_is_count),
    "resumed": _is_count,
    "ply_bytes": _is_count,
    "error": _optional(_is_line),
    "overrides": are_texts,
    "warnings": are_texts,
    "provenance": {
        **dict.fromkeys(FACTS, _optional(_is_text)),
        **dict.fromkeys(("cores", "threads"), _optional(_is_count)),
        "plugins": _optional(_mapping_to(_is_line)),
        "packages": _optional(_mapping_to(_optional(_is_text))),
        "git": _optional(_is_git_state),
    },
    "dose": {EACH: _is_dose},
    "files": {EACH: {"bytes": _is_count, "sha256": _matching(r"[0-9a-f]{64}")}},
    "timings": lambda value: isinstance(value, list) and all(map(_is_timing, value)),
    "summary": {EACH: _is_measurement},
}
FAILURE_RULES: Rule = {
    "error": _is_text,
    "kind": _is_text,
    "overrides": are_texts,
    "again": _is_text,
}
