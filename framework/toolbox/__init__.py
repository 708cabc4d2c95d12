"""Common parts of method families, which plugins inherit or call: warping augmenters, dropout,
capacities that measure the pull or work in rounds, what SH bands are worth, losses that look from
elsewhere and which Gaussians are neighbours."""

__all__ = ["bands", "dropout", "elsewhere", "neighbours", "pull", "rounds", "warping"]
