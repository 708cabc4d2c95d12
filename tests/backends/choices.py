"""Every rasterizer that can run here, for tests of the contract."""

from collections.abc import Iterator
from contextlib import nullcontext

import pytest
import torch

from framework.backends import RASTERIZERS, Rasterizer, build_rasterizer
from framework.errors import UserError
from tests.backends.stand_in import StandIn, installed

STAND_IN = "gsplat's functions in torch"
NAMES = [*RASTERIZERS, STAND_IN]


def opened(name: str) -> Iterator[Rasterizer]:
    """The rasterizer, ready; skips with its own reason where this machine cannot run it."""
    rasterizer = StandIn() if name == STAND_IN else build_rasterizer({"rasterizer": {"name": name}})
    try:
        rasterizer.ready()
    except UserError as error:
        pytest.skip(str(error))
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    with installed() if name == STAND_IN else nullcontext():
        yield rasterizer
    torch.set_num_threads(threads)
