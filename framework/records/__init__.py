"""A run as others see it: while it goes (`progress`, `notices`) and afterwards on disk (`record`,
`run_files`, `ply`), with where it comes from (`provenance`)."""

__all__ = ["notices", "ply", "progress", "provenance", "record", "run_files"]
