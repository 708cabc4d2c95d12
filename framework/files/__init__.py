"""Reading and writing safely: regular files within limits, archives, arrays, documents, paths that
stay inside their folder, locks, trees of values, the user's cache."""

__all__ = [
    "archives",
    "arrays",
    "cache",
    "documents",
    "limits",
    "locks",
    "opened",
    "paths",
    "tree",
    "whole",
]
