"""Reading and writing safely: regular and whole files, archives, arrays, JSON and YAML within
limits, pages, paths that stay inside their folder, locks, trees of values, the user's cache."""

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
    "tidy",
    "tree",
    "whole",
]
