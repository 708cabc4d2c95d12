"""A run as others see it: while it goes (`progress`, `notices`) and afterwards on disk (`record`,
`run_files`, `ply`, `cameras`, `photos`; what may stand there: `record_check`), with where it comes
from (`provenance`)."""

RUN_FOLDERS = "runs"  # in the folder of a study; each of its runs has one there

__all__ = [
    "RUN_FOLDERS",
    "archive",
    "cameras",
    "failure",
    "first_view",
    "notices",
    "photos",
    "ply",
    "progress",
    "provenance",
    "record",
    "record_check",
    "run_files",
    "search",
]
