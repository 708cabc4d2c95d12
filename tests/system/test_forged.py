"""Forged checkpoints of every plugin are refused in one line, or the training continues."""

from __future__ import annotations

import logging
from pathlib import Path

import pytest

from tests.contract.test_training import ACTING, ALL
from tests.security.forged import Forgery, forgeries

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore")]
TRAININGS = [*(({group: name}, "plugins") for group, name in ALL), (ACTING, "")]


@pytest.mark.parametrize(("names", "below"), TRAININGS, ids=str)
def test_a_forged_checkpoint_is_refused_or_used(
    names: dict[str, str], below: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.WARNING, "framework")
    forgery = Forgery(tmp_path, names)
    for what, tree, tensors in forgeries(forgery, below):
        caplog.clear()
        state = forgery.read(tree, tensors)
        if state is None:
            assert caplog.text.count("\n") == 1, what
        else:
            forgery.goes_on(state)
