"""Whether a `record.json` and the tables beside it are what a run writes: they may come from
elsewhere, and a report formats, sorts and opens files by what they hold."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

STEM = re.compile(r"[A-Za-z0-9_-][A-Za-z0-9._-]{0,199}")  # as `run_files.file_stems` writes them


def check_record(content: Any) -> None:
    """Raise ValueError, naming the field, unless every field that is read has its type."""
    _check("the record", content, isinstance(content, Mapping))
    for key in ("identity", "parameters_sha256", "status"):
        _check(key, content[key], isinstance(content[key], str))
    _check("status", content["status"], content["status"] in ("complete", "failed"))
    for key in ("peak_memory_bytes", "gaussians", "sh_degree", "ply_bytes"):
        _check(key, content[key], _is_count(content[key]))
    banded = content.get("banded")
    _check("banded", banded, banded is None or _is_count(banded))
    _check("resumed", content.get("resumed", 0), _is_count(content.get("resumed", 0)))
    _check("error", content["error"], content["error"] is None or _is_line(content["error"]))
    _check("overrides", content["overrides"], _are_texts(content["overrides"]))
    for key in ("config", "provenance"):
        _check(key, content[key], isinstance(content[key], Mapping))
    _check("config.seed", content["config"]["seed"], _is_count(content["config"]["seed"]))
    for group in ("scene", "depth", "init", "augment", "reg", "capacity"):
        options = content["config"].get(group)
        named = isinstance(options, Mapping) and isinstance(options.get("name"), str)
        _check(f"config.{group}", options, options is None or named or content["error"])
    _check_dose(content.get("dose", {}))
    _check_scene(content["scene"])
    _check_timings(content["timings"])
    _check_summary(content["summary"])


def check_columns(got: Sequence[str], needed: Iterable[str]) -> None:
    """Raise ValueError unless a table's columns are distinct and the needed ones are there."""
    missing = [name for name in needed if name not in got]
    _check("columns", [name[:40] for name in got[:20]], not missing and len(set(got)) == len(got))


def check_stems(stems: Iterable[str]) -> None:
    """Raise ValueError unless these name files in a folder, and nothing outside of it."""
    for stem in stems:
        _check("file", stem, STEM.fullmatch(stem))


def _check_dose(dose: Any) -> None:
    _check("dose", dose, isinstance(dose, Mapping))
    for name, value in dose.items():
        flat = value is None or isinstance(value, bool) or _is_line(value) or _is_number(value)
        _check(f"dose.{name}", value, flat and _is_line(name))


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
        _check(f"scene.{key}", scene[key], _is_line(scene[key]))
    for key in ("training", "test"):
        _check(f"scene.{key}", scene[key], _are_texts(scene[key]))


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


def _check(name: str, value: Any, good: object) -> None:
    if not good:
        raise ValueError(f"{name[:60]} is {' '.join(str(value)[:200].split())[:60]!r}")


def _is_count(value: Any) -> bool:
    return type(value) is int and 0 <= value < 2**63


def _is_number(value: Any) -> bool:
    # an integer may be beyond all floats
    return type(value) in (int, float) and abs(value) <= sys.float_info.max


def _is_line(value: Any) -> bool:
    return isinstance(value, str) and "\n" not in value


def _are_texts(value: Any) -> bool:
    return isinstance(value, list) and all(isinstance(text, str) for text in value)
