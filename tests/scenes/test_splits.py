"""Split protocols against their definition, and the shared option checks."""

from pathlib import Path

import numpy as np
import pytest

from framework.errors import UserError
from framework.scenes import LOADERS
from framework.scenes.splits import ALL, HELD_OUT, PROTOCOLS, UNTESTED, protocol
from tests.built import load_scene
from tests.scenes.synthetic import write_llff, write_scene

FOLDERS = sorted({*LOADERS} - {"embedded"})


def names(n: int) -> list[str]:
    return [f"{i:03d}.png" for i in range(n)]


@pytest.mark.parametrize(("n", "views"), [(9, 1), (20, 6), (25, 12), (49, 9), (300, 24)])
def test_llff_is_the_published_formula(n: int, views: int) -> None:
    split = protocol("llff").split(names(n), views, "here")
    pool = np.array([i for i in range(n) if i % 8 != 0])
    expected = pool[np.round(np.linspace(0, len(pool) - 1, views)).astype(int)]
    assert list(split.train) == expected.tolist()
    assert list(split.test) == list(range(0, n, 8))
    assert not set(split.train) & set(split.test)


@pytest.mark.parametrize("views", [3, 6, 9])
def test_dtu_is_the_published_list(views: int) -> None:
    split = protocol("dtu").split(names(49), views, "here")
    assert sorted([25, 22, 28, 40, 44, 48, 0, 8, 13][:views]) == list(split.train)
    assert len(split.test) == 25
    excluded = {3, 4, 5, 6, 7, 16, 17, 18, 19, 20, 21, 36, 37, 38, 39}
    assert not set(split.test) & ({25, 22, 28, 40, 44, 48, 0, 8, 13} | excluded)


def test_dtu_needs_the_whole_rig_and_has_nine_views_to_give() -> None:
    with pytest.raises(UserError, match=r"expected 49 images for scene\.split=dtu, got 48"):
        protocol("dtu").split(names(48), 3, "here")
    with pytest.raises(UserError, match="n_views of at most 9"):
        protocol("dtu").split(names(49), 10, "here")


@pytest.mark.parametrize("views", [12, 24])
def test_mip360_is_the_same_rule_as_llff(views: int) -> None:
    assert protocol("mip360").split(names(279), views, "here") == protocol("llff").split(
        names(279), views, "here"
    )


@pytest.mark.parametrize("name", sorted(n for n in PROTOCOLS if not n.endswith(HELD_OUT)))
def test_all_views_are_those_that_no_protocol_takes_for_testing(name: str) -> None:
    rule = protocol(name)
    photos = names(rule.images or 49)
    split = rule.split(photos, ALL, "here")
    pool, test = rule.divide(len(photos))
    assert (split.train, split.test) == (tuple(sorted(pool)), tuple(test))
    assert len(split.train) == {UNTESTED: 49, "dtu": 9, "blender": 100}.get(name, 42)
    assert split == rule.split(photos, len(pool), "here")


def test_a_scene_without_test_views(tmp_path: Path) -> None:
    every = [f"im{i:02d}.png" for i in range(10)]
    for loader, folder in (
        ("colmap", write_scene(tmp_path / "colmap")),
        ("mip360", write_scene(tmp_path / "mip360")),
        ("llff", write_llff(tmp_path / "llff")),
    ):
        options = {"path": str(folder), "n_views": ALL}
        scene = load_scene(loader, {**options, "split": UNTESTED})
        assert [view.name for view in scene.training.views] == every
        assert (scene.test, scene.protocol) == ((), UNTESTED)
        tested = load_scene(loader, options)
        assert [view.name for view in tested.training.views] == every[1:8] + every[9:]
        assert [view.name for view in tested.test] == ["im00.png", "im08.png"]
        assert tested.fingerprint != scene.fingerprint


@pytest.mark.parametrize("name", ["llff", "mip360", "dtu", UNTESTED])
def test_a_draw_takes_other_training_views_of_the_same_pool_and_tests_the_same(name: str) -> None:
    usual = protocol(name).split(names(49), 3, "here")
    pool, _ = protocol(name).divide(49)
    draws = [protocol(f"{name}_drawn{k}").split(names(49), 3, "here") for k in range(200)]
    assert {draw.test for draw in draws} == {usual.test}
    assert all(len({*draw.train}) == 3 and {*draw.train} <= {*pool} for draw in draws)
    assert all(draw.train == tuple(sorted(draw.train)) for draw in draws)
    assert {i for draw in draws for i in draw.train} == {*pool}, "any photo may be drawn"
    assert protocol(f"{name}_drawn7").split(names(49), 3, "here") == draws[7]
    for every in (ALL, len(pool)):
        with pytest.raises(UserError, match=r"^here: expected n_views below .* would be the same"):
            protocol(f"{name}_drawn7").split(names(49), every, "here")


def test_unknown_protocol_suggests() -> None:
    with pytest.raises(UserError, match="did you mean 'llff'"):
        protocol("lllf")


@pytest.mark.parametrize("loader", FOLDERS)
@pytest.mark.parametrize("n_views", ["every", "ALL", "3", "", 2.5, True, None])
def test_n_views_is_a_number_or_all(loader: str, n_views: object) -> None:
    message = (
        rf"^scene={loader}: expected n_views to be an integer >= 1 or all, got {n_views!r}; set"
    )
    with pytest.raises(UserError, match=message):
        load_scene(loader, {"path": "x", "n_views": n_views})
