"""Safe reading and writing: size limits, atomic writes, archives, arrays, JSON, YAML, HTML pages,
paths that stay inside their folder, locks, trees of values, and the user's cache."""

__all__ = [
    "archives",
    "arrays",
    "cache",
    "documents",
    "limits",
    "locks",
    "opened",
    "pages",
    "paths",
    "tree",
    "whole",
]
