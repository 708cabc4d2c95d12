"""The text of `--help`: a line per choice of every group, and the options with their values.

After `--help` with nothing but choices, such as `--help augment=safi`, their descriptions and
options. Hydra's own help composes the configuration for each of its eighty groups, which takes too
long; here the names come from the registry and the folders of the configuration.
"""

from __future__ import annotations

import inspect
import math
import re
import sys
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import yaml
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from framework import registry
from framework.command.config.meanings import from_yaml, meanings
from framework.command.config.schema import (
    CONF_DIR,
    GROUPS,
    OBJECT_GROUPS,
    SWEEPS_DIR,
    choices,
)
from framework.command.subcommands import SUBCOMMANDS
from framework.files.program import program
from framework.options import TrainerOptions
from framework.registry import parts_of

WIDTH = 80  # characters of a summary

HEADER = """\
fishersplat: sparse-view 3D Gaussian Splatting studies on a CPU

  one run       {program} augment=safi reg=uar
  a study       {program} +augment=safi +reg=uar seed=0,1,2 -m
  own photos    {program} scene=photos scene.path=DIR
  named study   {program} sweep=demo
  own plugins   {program} --plugins DIR reg=NAME
{subcommands}

-m makes a run for every combination of the values.
The report is written to reports/STUDY/report.md, each run to reports/STUDY/runs/NAME/.
"""


def help_text(overrides: Sequence[str]) -> str:
    """The help for a command line with `overrides`, whose values it shows."""
    with initialize_config_dir(config_dir=str(CONF_DIR), version_base="1.3"):
        config: Any = OmegaConf.to_container(compose("config", list(overrides)))
    typed = _choices_only(overrides)
    if typed:
        return _help_of(typed, config)
    options = "\n".join(_explained(config))
    chosen = "\n".join(line for group in GROUPS for line in _group_lines(group, _names(group)))
    others = [f"  {does:<13} {program()} {name} ..." for name, (_, does) in SUBCOMMANDS.items()]
    header = HEADER.format(program=program(), subcommands="\n".join(others))
    return f"{header}\nChoices, GROUP=NAME:\n{chosen}\n\nOptions, KEY=VALUE:\n\n{options}\n"


def _choices_only(overrides: Sequence[str]) -> dict[str, list[str]]:
    """group -> names, of a line with nothing but choices; else empty."""
    typed: dict[str, list[str]] = {}
    for word in overrides:
        group, _, value = word.lstrip("+").partition("=")
        names = re.findall(r"\w+", value)
        if group not in OBJECT_GROUPS or not names or not set(names) <= set(_names(group)):
            return {}
        typed[group] = names
    return typed


def _help_of(typed: Mapping[str, Sequence[str]], config: Mapping[str, Any]) -> str:
    """The help of these choices alone."""
    descriptions = [
        f"{group}={n}: {_description(group, n)}" for group, names in typed.items() for n in names
    ]
    options = "\n".join(_explained({group: config[group] for group in typed}))
    rest = f"All choices, and the other options: {program()} --help"
    return "\n\n".join([*descriptions, "Options, KEY=VALUE:", options, rest]) + "\n"


def _explained(plain: Mapping[str, Any]) -> Iterator[str]:
    """The lines of the configuration, each with its meaning."""
    means = top = from_yaml((CONF_DIR / "config.yaml").read_text(encoding="utf-8"))
    for line in yaml.safe_dump(dict(plain), sort_keys=False, width=math.inf).splitlines():
        key = line.split(":")[0]
        if line == f"{key}:" and not line.startswith(" "):
            means = {}
            for name in parts_of(key, plain[key]["name"]) if key in OBJECT_GROUPS else ():
                chosen = plain[key].get(name, plain[key])["name"]  # a variant's class is another
                means |= option_meanings(key, chosen)
            means = {"trainer": meanings(TrainerOptions), "metrics": top}.get(key, means)
        meaning = means.get(key.strip())
        yield f"{line:<27} # {meaning}" if meaning else line


def option_meanings(group: str, name: str) -> dict[str, str]:
    """option -> meaning, for `group=name`.

    Raises:
        UserError: for an unknown name.
    """
    cls: Any = registry.lookup(group, name)
    if group not in registry.GROUPS:
        return meanings(cls)
    weight = {} if cls.weighted() else {"weight": "has no effect and is refused: it adds no loss"}
    return registry.MEANINGS | weight | meanings(cls)


def _names(group: str) -> list[str]:
    folder = SWEEPS_DIR if group == "sweep" else CONF_DIR / group
    files = {path.stem for path in folder.glob("*.yaml")}
    return sorted(files.union(choices(group) if group in OBJECT_GROUPS else ()))


def _group_lines(group: str, names: Sequence[str]) -> Iterator[str]:
    yield f"\n  {group}"
    for name in names:
        yield f"    {name:<19} {summary(group, name)}".rstrip()


def summary(group: str, name: str) -> str:
    """Describe a choice in a line, by its docstring or its file's first comment."""
    return _first_sentence(_description(group, name))


def _description(group: str, name: str) -> str:
    """The description in a choice's source."""
    if group not in OBJECT_GROUPS or name not in choices(group):
        return _first_comment(group, name)
    cls = registry.lookup(group, name)
    title = f"`{group}={name}`: "
    module_doc = sys.modules[cls.__module__].__doc__ or ""
    if module_doc.startswith(title):
        return module_doc.removeprefix(title).strip()
    text = cls.__doc__ or ""
    return "" if text.startswith(f"{cls.__name__}(") else inspect.cleandoc(text)


def _first_sentence(text: str) -> str:
    # a full stop after an abbreviation ("et al. 2023") has no capital letter behind it
    sentence = re.split(r"[.:](?=\s+[A-Z]|$)", " ".join(text.split()), maxsplit=1)[0]
    return textwrap.shorten(sentence, WIDTH, placeholder=" ...")


def _first_comment(group: str, name: str) -> str:
    path = (SWEEPS_DIR if group == "sweep" else CONF_DIR / group) / f"{name}.yaml"
    text = path.read_text(encoding="utf-8") if path.is_file() else ""
    match = re.search(r"(^# (?!@).*\n?)+", text, re.MULTILINE)
    return match[0].replace("# ", "").strip() if match else ""
