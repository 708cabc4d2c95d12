"""The files of a failed run: `failed.json`, and the configuration that Hydra wrote."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from framework.errors import UserError
from framework.files.documents import read_json, read_yaml
from framework.files.limits import RUN_BYTES
from framework.records.record_check import check_config, check_failure

FAILED, COMPOSED = "failed.json", ".hydra/config.yaml"


@dataclass(frozen=True)
class Failure:
    """A failed run.

    Attributes:
        error: one line.
        kind: a word or two.
        again: the command that repeats the run. Both texts are "" and the composed config is empty
            if they were not kept.
    """

    error: str
    kind: str
    overrides: tuple[str, ...]
    config: Mapping[str, Any]
    again: str = ""


def read_failure(run_dir: Path) -> Failure:
    """Raises UserError when the files are missing or damaged."""
    path, composed = run_dir / FAILED, run_dir / COMPOSED
    content = read_json(path, RUN_BYTES)
    config = read_yaml(composed) if os.path.lexists(composed) else None
    try:
        check_failure(content)
        check_config(config or {}, complete=False)
    except (ValueError, KeyError, TypeError) as error:
        raise UserError(
            f"{path}: expected the error of a failed run, got a damaged file"
            f" ({type(error).__name__}: {error}); delete that folder and run again"
        ) from error
    kind, again = content.get("kind", ""), content.get("again", "")
    return Failure(content["error"], kind, tuple(content["overrides"]), config or {}, again)
