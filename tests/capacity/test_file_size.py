"""`capacity.bytes`: the compact file of a run is no larger, whatever is trained and joined."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from framework import registry
from framework.errors import UserError
from framework.exports.compact import Photo, compact
from framework.exports.opened import NamedCamera, OpenedRun
from framework.run.plane import textured_plane
from framework.toolbox.file_size import file_bytes, most_gaussians
from framework.train.trainer import Trained
from plugins.capacity.budget import Budget
from tests.capacity.population import pulls, watched
from tests.contract.test_members import trained
from tests.plugins.fakes import wall_of_gaussians

SPAN = {"start": 0.0, "stop": 1.0, "every": 0.2, "until": 0.6}


@pytest.mark.parametrize(
    ("text", "size"),
    [("300kB", 300_000), ("1.5 MB", 1_500_000), ("2000", 2000), ("2000B", 2000), ("none", 0)],
)
def test_a_size_is_a_number_with_a_unit(text: str, size: int) -> None:
    assert file_bytes(text) == size


@pytest.mark.parametrize("capacity", ["budget", "evidence"])
@pytest.mark.parametrize("text", ["300 apples", "0", "-5", "kB", "1e9", "999", "nan", "0.5kB", ""])
def test_what_is_no_size_ends_in_one_line(capacity: str, text: str) -> None:
    with pytest.raises(UserError, match=r"capacity\.bytes: expected a size of at least 1 kB"):
        registry.build("capacity", {"name": capacity, "bytes": text})


def test_a_limit_that_no_round_would_keep_is_refused() -> None:
    with pytest.raises(UserError, match="never brought to the limit"):
        registry.build("capacity", {"name": "evidence", "bytes": "9kB", "start": 0.7})


def test_bands_cost_bytes_and_members_share_them() -> None:
    assert most_gaussians(300_000, 0) > most_gaussians(300_000, 1) > most_gaussians(300_000, 3)
    assert file_bytes(Budget(bytes="300kB").shared(4).bytes) == 75_000
    assert Budget().shared(4).bytes == "none"
    with pytest.raises(UserError, match="at least 1 kB for each of the 4 joined trainings"):
        Budget(bytes="2kB").shared(4)


@pytest.mark.parametrize("n", [90, 400])
def test_the_budget_is_what_fits(n: int) -> None:
    for step in range(9, 60, 10):
        budget, ctx = Budget(bytes="2kB"), watched(wall_of_gaussians(n), step)
        edits, _ = budget.update(ctx, budget.init_state(ctx), pulls(torch.ones(n)))
        if edits is not None and edits.keep is not None:
            n = int(edits.keep.sum()) + (0 if edits.append is None else len(edits.append))
    assert n == most_gaussians(2000, ctx.gaussians.sh_degree)


def exported(result: Trained) -> int:
    """The bytes of the compact file."""
    views = textured_plane(1)[0].views
    cameras = tuple(NamedCamera(view.name, view.camera) for view in views)
    photos = [Photo(view.camera, view.image, view.mask, torch.ones(3)) for view in views]
    run = OpenedRun(Path(), result.gaussians, result.background, cameras, 0.01)
    return len(compact(run, photos).content)


@pytest.mark.parametrize("capacity", ["budget", "evidence"])
@pytest.mark.parametrize("trainer", [{"members": 1}, {"kept": 0}, {"kept": 1}])
def test_the_file_is_no_larger(
    tmp_path: Path,
    capacity: str,
    trainer: dict[str, Any],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def all_pay(*_: Any) -> NDArray[np.int64]:
        return np.zeros(0, np.int64)

    monkeypatch.setattr("plugins.capacity.evidence.removable", all_pay)
    chosen: dict[str, Any] = {"name": capacity, **SPAN}
    free = trained(tmp_path / "a", capacity={**chosen, "bytes": "1MB"}, **trainer)
    limited = trained(tmp_path / "b", capacity={**chosen, "bytes": "2kB"}, **trainer)
    assert exported(limited) <= 2000 < exported(free)
