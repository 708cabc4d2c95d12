"""Common parts of method families, which plugins inherit or call: warping augmenters, dropout,
capacities that measure the pull or work in rounds, and what SH bands are worth."""

__all__ = ["bands", "dropout", "pull", "rounds", "warping"]
