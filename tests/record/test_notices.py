"""What the framework logs during a run reaches the screen, once, and nothing is left behind."""

import logging

from framework.records.notices import noted
from tests.record.test_reuse import Recorder

LOG = logging.getLogger("framework.scenes.anything")


def test_infos_and_warnings_become_notes() -> None:
    progress = Recorder()
    with noted(progress):
        LOG.debug("too much")
        LOG.info("generating %d views", 3)
        LOG.warning("one view\noverlaps no other")
        logging.getLogger("elsewhere").warning("not ours")
    assert progress.notes == ["generating 3 views", "warning: one view overlaps no other"]
