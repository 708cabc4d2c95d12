"""Who draws: the choices of `rasterizer=NAME`, behind one contract (`contract.Rasterizer`).

`numba` is `framework.kernels`, compiled for the CPU; `reference` its readable twin in torch;
`gsplat` draws on a GPU. See docs/rasterizers.md.
Importing this package loads neither torch nor numba.
"""

from collections.abc import Mapping
from typing import Any

from framework.backends.contract import Rasterizer, RenderGradient
from framework.backends.gsplat_gpu import Gsplat
from framework.backends.numba_cpu import Numba
from framework.backends.torch_cpu import Reference
from framework.errors import UserError, nearest_hint

__all__ = ["NUMBA", "RASTERIZERS", "Rasterizer", "RenderGradient", "build_rasterizer"]

RASTERIZERS: dict[str, type] = {cls.name: cls for cls in (Numba, Gsplat, Reference)}
NUMBA = Numba()


def build_rasterizer(config: Mapping[str, Any]) -> Rasterizer:
    """The rasterizer of a run's configuration; `numba` of one from before there was a choice.

    Raises:
        UserError: on an unknown name.
    """
    options = dict(config.get("rasterizer") or {"name": NUMBA.name})
    name = str(options.pop("name", ""))
    if name not in RASTERIZERS:
        raise UserError(f"rasterizer={name}: unknown rasterizer; {nearest_hint(name, RASTERIZERS)}")
    rasterizer: Rasterizer = RASTERIZERS[name](**options)
    return rasterizer
