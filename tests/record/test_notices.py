"""What the framework logs during a run reaches the screen, once, and nothing is left behind."""

from __future__ import annotations

import io
import logging
from pathlib import Path

import pytest

from framework.records.notices import noted
from framework.records.progress import Terminal
from framework.run import preparation
from tests.record.test_reuse import Recorder, group, run_experiment, small_config

LOG = logging.getLogger("framework.scenes.anything")


def test_infos_and_warnings_become_notes() -> None:
    progress = Recorder()
    with noted(progress):
        LOG.debug("too much")
        LOG.info("generating %d views", 3)
        LOG.warning("one view\noverlaps no other")
        logging.getLogger("elsewhere").warning("not ours")
    assert progress.notes == ["generating 3 views", "warning: one view overlaps no other"]


def test_runs_of_one_process_do_not_add_up() -> None:
    logger = logging.getLogger("framework")
    before = logger.level, list(logger.handlers)
    for _ in range(2):
        progress = Recorder()
        with pytest.raises(KeyError), noted(progress):
            LOG.info("once")
            raise KeyError
        assert progress.notes == ["once"]
    LOG.info("after the runs")
    assert progress.notes == ["once"]
    assert (logger.level, logger.handlers) == before


def test_a_note_is_a_line_of_its_own() -> None:
    stream = io.StringIO()
    with noted(Terminal("none+none seed 0", stream=stream, in_place=False)):
        LOG.info("generating")
    assert stream.getvalue() == "none+none seed 0 · generating\n"


def test_a_first_run_tells_that_it_generates_the_scene(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FISHERSPLAT_CACHE", str(tmp_path / "cache"))
    preparation.forget()
    progress = Recorder()
    run_experiment(small_config(group("depth", "ground_truth")), tmp_path / "run", progress)
    assert [note for note in progress.notes if note.startswith("generating the embedded scene")]
