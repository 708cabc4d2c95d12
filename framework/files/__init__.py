"""Reading and writing safely: whole files, archives and arrays within limits, paths that stay
inside their folder, locks, trees of values, the user's cache."""

__all__ = ["archives", "arrays", "cache", "limits", "locks", "paths", "tree", "whole"]
