"""Depth of the training views, and what follows from it.

A provider is a frozen dataclass of options derived from `options.DepthProvider`. Its
`measure(training)` returns a `framework.types.DepthMap` per training view, and
`fingerprint(training)` hashes the files that it reads. `exposure` estimates from photos and depth
how the photos were exposed; `pose_check` whether poses fit the photos. Importing this package loads
neither torch nor numba.
"""

from framework.depth.options import DepthProvider, unspoiled
from framework.depth.providers import PROVIDERS

__all__ = [
    "PROVIDERS",
    "DepthProvider",
    "consistency",
    "exposure",
    "itermvs",
    "matching",
    "options",
    "pose_check",
    "transfer",
    "unspoiled",
]
