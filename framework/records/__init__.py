"""A run as others see it: while it goes (`progress`, `notices`) and afterwards on disk (`record`,
`run_files`, `ply`, `cameras`, `photos`; what may stand there: `record_check`), with where it comes
from (`provenance`)."""

__all__ = [
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
