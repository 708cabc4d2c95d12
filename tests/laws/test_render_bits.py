"""A render and its gradients have the same bits on any number of threads and in any process."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from torch import Tensor

from framework.compute.parallel import set_threads
from framework.kernels import rasterize
from tests.laws.render_bits import render_bits
from tests.numerics.scenes import random_case, wide_case

ROOT = Path(__file__).parents[2]


def test_same_bits_for_any_thread_count() -> None:
    digests = {threads: render_bits(threads) for threads in (1, 2, 3)}
    again = {threads: render_bits(threads) for threads in (3, 1, 2)}
    assert len({*digests.values(), *again.values()}) == 1, (digests, again)


def test_renders_may_wait_while_the_number_of_threads_changes() -> None:
    """Two of unequal size, differentiated in reverse order; each has its buffers to itself."""
    cases = [wide_case(200), wide_case(201), random_case(5)]

    def gradients(first: int, then: int) -> list[Tensor]:
        set_threads(first)
        leaves = [case.gaussians.map(lambda t: t.clone().requires_grad_()) for case in cases]
        renders = [rasterize(g, c.camera) for g, c in zip(leaves, cases, strict=True)]
        set_threads(then)
        for render in reversed(renders):
            (render.rgb.square().sum() + render.depth.sum()).backward()
        return [t.grad for g in leaves for _, t in g.items() if t.grad is not None]

    try:
        expected = gradients(1, 1)
        for threads in ((3, 1), (1, 3), (40, 2)):
            assert all(map(torch.equal, gradients(*threads), expected))
    finally:
        set_threads(0)


@pytest.mark.slow
def test_same_bits_in_another_process_with_a_cold_cache(tmp_path: Path) -> None:
    """The child compiles every kernel of a step again. In the suite `tests/golden/test_bits.py`
    guards it: kernels are compiled there after every change, and the bits are committed."""
    command = [sys.executable, "-m", "tests.laws.render_bits", "2"]
    child = subprocess.run(
        command,
        cwd=ROOT,
        env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert child.returncode == 0, child.stderr
    assert any(tmp_path.rglob("*.nbi")), "the child did not compile into its own cache"
    assert child.stdout.strip() == render_bits(1, fisher=False)
