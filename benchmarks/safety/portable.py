"""Is the arithmetic that is our own (`framework/compute/portable.py`) the same bits here as
elsewhere? Prints a hash of each function's results; needs numba and NumPy alone.

    python benchmarks/safety/portable.py

So it runs where the rest does not, on arm64 for instance. The last line is NumPy's own exponential,
which the processor's vectors make another one.
"""

from __future__ import annotations

import hashlib
import platform
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from framework.compute import portable


def results() -> dict[str, np.ndarray]:
    """Function -> its values for arguments that are drawn once for all."""
    draw = np.random.Generator(np.random.PCG64(33))
    x = np.concatenate([draw.uniform(-40, 40, 20_000), draw.standard_normal(5_000) * 1e-3])
    y = np.abs(x) + 1e-9
    a, b = draw.standard_normal((2, 200, 4, 4))
    return {
        "exp": portable.exp(x),
        "log": portable.log(y),
        "log1p": portable.log1p(y),
        "power": portable.power(y, 2.4),
        "powers": portable.power(y, x / 40),
        "arctan": portable.arctan(x),
        "product": np.stack([portable.product(u, v) for u, v in zip(a, b, strict=True)]),
        "inverse": np.stack([portable.inverse(u) for u in a[:50]]),
        "NumPy's exp": np.exp(x),
    }


def main() -> int:
    print(f"{platform.machine()}, NumPy {np.__version__}")
    for name, values in results().items():
        print(name, hashlib.sha256(np.ascontiguousarray(values).tobytes()).hexdigest()[:16])
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
