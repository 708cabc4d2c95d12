"""All methods of a seed start from the same Gaussians and meet the real views in the same order.

That one more plugin moves no other draw is in `tests/contract/test_training.py`.
"""

from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from hydra import compose, initialize_config_dir

from framework.command.config.naming import plain
from framework.command.config.schema import CONF_DIR, choices, register_config
from framework.compute import parallel
from framework.options import TrainerOptions
from framework.records.progress import Silent
from framework.records.record import parameters_sha256
from framework.run import preparation, training
from framework.run.plane import textured_plane
from framework.run.training import Run, initial, train
from framework.train.epoch import Item, ordered
from framework.train.trainer import Trainer
from framework.types import View

STEPS = 6
METHODS = [
    *[(name, "none") for name in choices("augment")],
    *[("none", name) for name in [*choices("reg"), "uar_hard", "dropgaussian"] if name != "none"],
    ("safi", "uar"),
]
AUGMENTING = [name for name in choices("augment") if name != "none"]


class Noting(Trainer):
    """Notes the Gaussians it starts from and the views it trains on."""

    seen: list[tuple[str, list[str]]]

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self.names: list[str] = []
        self.seen.append((parameters_sha256(self.field.params), self.names))

    def _pick(self) -> tuple[Item, ...]:
        items = super()._pick()
        for item in items:
            self.names.append("pseudo" if item.view.pseudo else item.view.name)
        return items


@pytest.fixture
def seen(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, list[str]]]:
    """(hash of the first Gaussians, names of the views in order) of every training to come."""
    monkeypatch.setattr(training, "Trainer", Noting)
    monkeypatch.setattr(Noting, "seen", [], raising=False)
    return Noting.seen


def start(folder: Path, augment: str, reg: str, seed: int) -> None:
    """Initialise and train a little, as `run_experiment` does, with methods that act at once."""
    register_config()
    always = [f"{group}.{key}" for group in ("augment", "reg") for key in ("start=0", "stop=1")]
    line = [f"augment={augment}", f"reg={reg}", f"seed={seed}", *always]
    line += ["depth=ground_truth", "init.budget=500", "scene.width=96", "scene.height=72"]
    line += [f"trainer.steps={STEPS}", "trainer.evaluations=1"]
    line += ["augment.min_coverage=0.1"] if augment == "mvs_warp" else []  # one photo covers less
    with initialize_config_dir(config_dir=str(CONF_DIR), version_base="1.3"):
        config = plain(compose("config", line))
    parallel.set_threads(1)
    key = preparation.options_of(config, "scene")
    scene = preparation.load_scene(key).result
    depth = preparation.estimate_depth(key, preparation.options_of(config, "depth"), "").result
    options = TrainerOptions(**config["trainer"])
    run_dir = folder / f"{augment}-{reg}-{seed}"
    run = Run(
        scene,
        depth,
        lambda ours: initial(config, scene, depth, options, ours),
        run_dir,
        "identity",
        force=False,
    )
    train(run, config, Silent())


def real(names: list[str]) -> list[str]:
    return [name for name in names if name != "pseudo"]


def test_all_methods_of_a_seed_start_alike_and_see_the_real_views_alike(
    seen: list[tuple[str, list[str]]], tmp_path: Path
) -> None:
    for augment, reg in METHODS:
        start(tmp_path, augment, reg, seed=3)
    hashes, orders = zip(*seen, strict=True)
    assert len(set(hashes)) == 1
    plain_order = orders[METHODS.index(("none", "none"))]
    assert len(plain_order) == STEPS and "pseudo" not in plain_order
    for method, order in zip(METHODS, orders, strict=True):
        assert real(order) == plain_order, method
        assert ("pseudo" in order) == (method[0] in AUGMENTING), method
    start(tmp_path, "none", "none", seed=4)
    assert seen[-1][0] != hashes[0] and seen[-1][1] != plain_order


def test_every_epoch_is_a_pass_over_the_real_views() -> None:
    views = textured_plane(0)[0].views
    for epoch in range(20):
        steps = ordered(views, [], 0, epoch)
        assert Counter(v.name for (v,) in steps) == Counter(v.name for v in views)


def test_pseudo_views_join_any_step_and_move_no_real_view() -> None:
    views = textured_plane(0)[0].views
    pseudo = [View(f"pseudo-{i}", v.camera, v.image) for i, v in enumerate(views[:2])]
    places: Counter[int] = Counter()
    for epoch in range(400):
        alone = [view.name for (view,) in ordered(views, [], 0, epoch)]
        mixed = ordered(views, pseudo, 0, epoch)
        assert [step[0].name for step in mixed] == alone
        places.update(i for i, step in enumerate(mixed) for _ in step[1:])
    assert sum(places.values()) == 800 and set(places) == set(range(3))
    sigma = (800 / 3 * 2 / 3) ** 0.5
    assert all(abs(count - 800 / 3) < 4 * sigma for count in places.values())


def test_the_order_differs_between_epochs_and_seeds() -> None:
    views = textured_plane(0)[0].views
    orders = {
        tuple(v.name for (v,) in ordered(views, [], seed, epoch))
        for seed in range(3)
        for epoch in range(10)
    }
    assert len(orders) == 6
