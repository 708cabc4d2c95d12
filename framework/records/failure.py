"""`failed.json` of a run whose last attempt failed."""

from dataclasses import dataclass
from pathlib import Path

from framework.errors import UserError
from framework.files.documents import read_json
from framework.files.limits import RUN_BYTES
from framework.records.record_check import check_failure

FAILED = "failed.json"


@dataclass(frozen=True)
class Failure:
    """A failed run.

    Attributes:
        error: one line.
        kind: a word or two.
        again: the command that repeats the run; "" if unknown.
    """

    error: str
    kind: str
    overrides: tuple[str, ...]
    again: str


def read_failure(run_dir: Path) -> Failure:
    """Raises UserError when the file is missing or damaged."""
    path = run_dir / FAILED
    content = read_json(path, RUN_BYTES)
    try:
        check_failure(content)
    except (ValueError, KeyError, TypeError) as error:
        raise UserError(
            f"{path}: expected the error of a failed run, got a damaged file"
            f" ({type(error).__name__}: {error}); delete that folder and run again"
        ) from error
    overrides = tuple(content["overrides"])
    return Failure(content["error"], content["kind"], overrides, content["again"])
