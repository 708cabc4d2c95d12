"""Check that a `record.json`, a `failed.json` and their tables are what a run writes. They may come
from elsewhere, and a report formats, sorts and opens files by their content.

Texts are whole and of bounded length already (`framework.files.documents`). Numbers are small
enough for the report's sums of squares to be finite.
"""

from __future__ import annotations

import re
import typing
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from framework.metrics.values import LARGEST
from framework.options import TrainerOptions

STEM = re.compile(r"[A-Za-z0-9_-][A-Za-z0-9._-]{0,199}")  # as `run_files.file_stems` writes them
TAGS = re.compile(r"[A-Za-z0-9_-]{0,40}( [A-Za-z0-9_-]{1,40}){0,8}")
DIGEST, SHA256 = re.compile(r"[0-9a-f]{0,64}"), re.compile(r"[0-9a-f]{64}")
NAME_LENGTH = 255  # of a scene or a choice: as of a folder
GROUPS = ("scene", "depth", "init", "augment", "reg", "capacity", "rasterizer")
FACTS = (
    "fishersplat",
    "python",
    "code",
    "cpu",
    "system",
    "bits",
    "gpu",
    "cuda",
    "gsplat",
)  # of the provenance: texts
COUNTS = ("cores", "threads")
TRAINER = typing.get_type_hints(TrainerOptions)


def check_record(content: Any) -> None:
    """Raise ValueError, naming the field, unless every field that is read has its type."""
    _check("the record", content, isinstance(content, Mapping))
    for key, good in FIELDS.items():
        _check(key, content[key], good(content[key]))
    for key, good in ADDED.items():  # older records lack these
        _check(key, content.get(key), key not in content or good(content[key]))
    check_config(content["config"], complete=content["status"] == "complete")
    _check("config.seed", content["config"].get("seed"), "seed" in content["config"])
    _check_provenance(content["provenance"])
    _check_dose(content.get("dose", {}))
    _check_files(content.get("files", {}))
    _check_scene(content["scene"])
    _check_timings(content["timings"])
    _check_summary(content["summary"])


def check_failure(content: Any) -> None:
    """The same of a `failed.json`."""
    _check("the content", content, isinstance(content, Mapping))
    _check("error", content["error"], isinstance(content["error"], str))
    _check("kind", content.get("kind", ""), isinstance(content.get("kind", ""), str))
    _check("overrides", content["overrides"], are_texts(content["overrides"]))
    _check("again", content.get("again", ""), isinstance(content.get("again", ""), str))


def check_config(config: Any, complete: bool) -> None:
    """The same of a run's configuration; that of a failed run may lack parts."""
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
    _check("config.scene.path", path, path is None or isinstance(path, str))
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
    return isinstance(value, list) and all(isinstance(text, str) for text in value)


def _check_provenance(provenance: Any) -> None:
    _check("provenance", provenance, isinstance(provenance, Mapping))
    for key in FACTS:
        _check(
            f"provenance.{key}", provenance.get(key), isinstance(provenance.get(key), str | None)
        )
    for key in COUNTS:
        _check(
            f"provenance.{key}",
            provenance.get(key),
            provenance.get(key) is None or _is_count(provenance[key]),
        )
    packages, git = provenance.get("packages"), provenance.get("git")
    plugins = provenance.get("plugins", {})
    hashes = isinstance(plugins, Mapping) and all(map(_is_line, (*plugins, *plugins.values())))
    _check("provenance.plugins", plugins, hashes)
    texts = isinstance(packages, Mapping) and all(
        isinstance(number, str | None) for number in packages.values()
    )
    _check("provenance.packages", packages, packages is None or texts)
    state = isinstance(git, Mapping) and isinstance(git.get("sha"), str) and "dirty" in git
    _check("provenance.git", git, git is None or state)


def _check_dose(dose: Any) -> None:
    _check("dose", dose, isinstance(dose, Mapping))
    for name, value in dose.items():
        flat = value is None or isinstance(value, bool) or _is_line(value) or _is_number(value)
        _check(f"dose.{name}", value, flat and _is_line(name))


def _check_files(files: Any) -> None:
    _check("files", files, isinstance(files, Mapping))
    for name, of in files.items():
        good = isinstance(of, Mapping) and _is_count(of.get("bytes")) and _is_name(name)
        _check(f"files.{name}", of, good and SHA256.fullmatch(str(of.get("sha256"))))


def _check_scene(scene: Any) -> None:
    _check("scene", scene, scene is None or isinstance(scene, Mapping))
    if scene is None:
        return
    _check(
        "scene",
        list(scene),
        set(scene) == {"name", "protocol", "fingerprint", *("training", "test")},
    )
    for key in ("name", "protocol", "fingerprint"):
        _check(f"scene.{key}", scene[key], _is_name(scene[key]))
    for key in ("training", "test"):
        _check(f"scene.{key}", scene[key], are_texts(scene[key]))


def _check_timings(timings: Any) -> None:
    _check("timings", timings, isinstance(timings, list))
    for entry in timings:
        _check("timings", entry, isinstance(entry, Mapping) and isinstance(entry["stage"], str))
        for key in ("wall_s", "cpu_s"):
            _check(f"timings.{key}", entry[key], _is_number(entry[key]) and entry[key] >= 0)


def _check_summary(summary: Any) -> None:
    _check("summary", summary, isinstance(summary, Mapping))
    for name, entry in summary.items():
        _check(f"summary.{name}", entry, isinstance(entry, Mapping))
        mean, reason = entry["mean"], entry["missing"]
        _check(
            f"summary.{name}", entry, isinstance(reason, str) if mean is None else _is_number(mean)
        )


def _check_all(name: str, values: Iterable[str], good: Callable[[str], object]) -> None:
    for value in values:
        _check(name, value, good(value))


def _check(name: str, value: Any, good: object) -> None:
    if not good:
        raise ValueError(f"{name[:60]} is {' '.join(str(value)[:200].split())[:60]!r}")


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


def _is_count(value: Any) -> bool:
    return type(value) is int and 0 <= value < 2**63


def _is_number(value: Any) -> bool:
    return type(value) in (int, float) and abs(value) <= LARGEST


def _is_line(value: Any) -> bool:
    return isinstance(value, str) and "\n" not in value


def _is_name(value: Any) -> bool:
    return _is_line(value) and 0 < len(value) <= NAME_LENGTH and value.strip() != ""


FIELDS: dict[str, Callable[[Any], object]] = {
    "identity": lambda value: isinstance(value, str),
    "parameters_sha256": lambda value: isinstance(value, str) and DIGEST.fullmatch(value),
    "status": lambda value: value in ("complete", "failed"),
    "peak_memory_bytes": _is_count,
    "gaussians": _is_count,
    "sh_degree": lambda value: _is_count(value) and value <= 10,
    "ply_bytes": _is_count,
    "error": lambda value: value is None or _is_line(value),
    "overrides": are_texts,
}
ADDED: dict[str, Callable[[Any], object]] = {
    "banded": lambda value: value is None or _is_count(value),
    "resumed": _is_count,
    "warnings": are_texts,
}
