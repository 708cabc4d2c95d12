"""Where a run's folder is: `reports/<study>/runs/<augment>-<reg>-s<seed>-<hash>`.

The two names are OmegaConf resolvers, so that Hydra itself, its launchers and `hydra.run.dir=DIR`
agree on the folder. They are registered on import of `framework.command.cli`: a launcher's fresh
process imports that module when it unpickles the task function.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from omegaconf import MISSING, DictConfig, OmegaConf

from framework.command.config.check import check
from framework.command.config.schema import rows
from framework.records import RUN_FOLDERS
from framework.records.provenance import NEUTRAL_KEYS
from framework.scenes import DRAWN, HELD_OUT, untested

# A run's name must not depend on these: the seed is written out, the others do not change a run.
NOT_HASHED = ("seed", *NEUTRAL_KEYS)


def plain(config: DictConfig) -> dict[str, Any]:
    """The task's part of a composed configuration as plain, resolved values; missing is "???"."""
    return {str(key): _plain_value(config, str(key)) for key in config if key != "hydra"}


def _plain_value(config: DictConfig, key: str) -> Any:
    if OmegaConf.is_missing(config, key):
        return MISSING
    value = config[key]  # converts what `${...}` gives to the declared type
    return OmegaConf.to_container(value, resolve=True) if OmegaConf.is_config(value) else value


def study_name(config: Mapping[str, Any]) -> str:
    """Return the option `study`, else a name of the scene: `embedded`, `llff_fern_3v`.

    Scenes without test views end with `_untested` and those judged on held-out training views with
    `_held_out`, as their numbers cannot be compared with others. All draws of training views are
    one study, `llff_fern_3v_drawn`.
    """
    if config["study"] is not None:
        return str(config["study"])
    options = dict(config["scene"])
    loader = str(options["name"])
    if "path" in options:
        stem = _file_name(Path(str(options["path"])).resolve().name)
        split = str(options.get("split"))
        odd = "_untested" if untested(split) else DRAWN if DRAWN in split else ""
        odd += HELD_OUT if split.endswith(HELD_OUT) else ""
        scene = stem if stem.startswith(loader) else f"{loader}_{stem}"
        number = f"_{options['n_views']}v" if "n_views" in options else ""
        return f"{scene}{number}{odd}"
    default = {name: option.default for name, _, option in rows("scene", loader)}
    views = options.get("n_views")
    return loader if views == default.get("n_views") else f"{loader}_{views}v"


def run_name(config: Mapping[str, Any], augment: str, reg: str) -> str:
    """`<augment>-<reg>-s<seed>-<8 hex digits>` of the SHA-256 of all other options."""
    hashed = {key: value for key, value in config.items() if key not in NOT_HASHED}
    digest = hashlib.sha256(json.dumps(hashed, sort_keys=True).encode()).hexdigest()[:8]
    return f"{_file_name(augment)}-{_file_name(reg)}-s{config['seed']}-{digest}"


def study_dir(run_dir: Path) -> Path:
    """The folder whose report covers `run_dir`: the study's; for a folder given by hand, itself."""
    return run_dir.parent.parent if run_dir.parent.name == RUN_FOLDERS else run_dir


def register_resolvers() -> None:
    """Make `${fishersplat.study:}` and `${fishersplat.run_name:}` known to OmegaConf.

    Both check the configuration first: a bad one is refused before a folder is made.
    """
    for name, resolver in (("study", _resolve_study), ("run_name", _resolve_run_name)):
        OmegaConf.register_new_resolver(f"fishersplat.{name}", resolver, replace=True)


def _resolve_study(*, _root_: DictConfig) -> str:
    return study_name(_checked(_root_))


def _resolve_run_name(*, _root_: DictConfig) -> str:
    chosen = _root_.hydra.runtime.choices
    return run_name(_checked(_root_), str(chosen.augment), str(chosen.reg))


def _checked(root: DictConfig) -> dict[str, Any]:
    config = plain(root)
    check(config)
    return config


def _file_name(text: str) -> str:
    """`text` with everything that is awkward in a file name replaced by `_`."""
    return re.sub(r"[^\w.-]", "_", text)
