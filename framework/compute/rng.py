"""Named random streams; nothing in the project draws from a global generator.

A stream is fixed by (seed, purpose, step): adding a plugin or a purpose moves no other draw, and a
resumed run draws what an uninterrupted one would.
"""

import hashlib

import numpy as np


def stream(seed: int, purpose: str, step: int = 0) -> np.random.Generator:
    """A fresh generator for `purpose` at `step`; the same arguments give the same draws."""
    digest = hashlib.sha256(f"{int(seed)}/{purpose}/{int(step)}".encode()).digest()
    key = np.frombuffer(digest[:16], dtype=np.uint64)
    return np.random.Generator(np.random.Philox(key=key))
