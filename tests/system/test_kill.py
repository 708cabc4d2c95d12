"""Nothing is lost, changed or done twice when a study is killed by SIGKILL and begun again."""

import time
from dataclasses import replace

import pytest

from tests.system.forked import Place, ended, kill

pytestmark = pytest.mark.slow

LAUNCHERS = {
    "basic": (),
    "joblib": ("hydra/launcher=joblib", "hydra.launcher.n_jobs=2"),
    "submitit_local": ("hydra/launcher=submitit_local",),
    "ray": ("hydra/launcher=ray", "+hydra.launcher.ray.init.num_cpus=2"),
}
WRITES = {  # what is being written: its temporary file in the study
    "a checkpoint": "runs/*/checkpoints/.step-*.tmp",
    "a render": "runs/*/renders/.*.tmp",
    "the Gaussians": "runs/*/.point_cloud.ply.*.tmp",
    "a table": "runs/*/.*.csv.*.tmp",
    "a record": "runs/*/.record.json.*.tmp",
    "the report or a figure": ".*.tmp",
}
RANDOM_KILLS = 8


@pytest.mark.parametrize("written", WRITES)
def test_killed_while_a_file_is_written(
    written: str, place: Place, undisturbed: dict[str, str]
) -> None:
    child = place.begin()
    code = place.wait_for(WRITES[written], child)
    if code is None:
        kill(child)
    before = place.records()
    place.finish()
    assert before.items() <= place.records().items()
    place.check(undisturbed)


@pytest.mark.parametrize("launcher", LAUNCHERS)
def test_killed_at_random_moments(launcher: str, place: Place, undisturbed: dict[str, str]) -> None:
    """Each command gets a little longer than the one before."""
    if launcher == "ray":
        pytest.importorskip("hydra_plugins.hydra_ray_launcher", reason="needs fishersplat[ray]")
    place = replace(place, words=LAUNCHERS[launcher])
    before: dict[str, tuple[int, int]] = {}
    for number in range(RANDOM_KILLS):
        child = place.begin()
        time.sleep((number + 1) * place.draw.random())
        if ended(child) is None:
            kill(child)
        assert before.items() <= place.records().items()
        before = place.records()
    place.finish()
    assert before.items() <= place.records().items()
    place.check(undisturbed)
