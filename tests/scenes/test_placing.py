"""The focal length that the search for poses uses, and when it stops early."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from framework.scenes.photos import placing, search
from framework.scenes.photos.attempt import Attempt
from framework.scenes.photos.options import STEPS
from framework.scenes.photos.placing import choose
from framework.scenes.photos.prepare import Photo
from framework.scenes.photos.process import Messages
from framework.scenes.photos.result import Link, Overruled, Try


def links(shift: float, flat: bool) -> list[Link]:
    return [Link(f"{k}.jpg", f"{k + 1}.jpg", 400, shift, flat) for k in range(3)]


TOLD = 400.0


def photos(focal_px: float | None) -> list[Photo]:
    names = [f"{k}.jpg" for k in range(4)]
    return [Photo(name, name, 640, 480, focal_px, (), False) for name in names]


def model(focal_px: float, error: float, n: int = 4, k1: float = 0.0) -> Any:
    """What `choose` needs from a reconstruction by pycolmap."""
    camera = SimpleNamespace(params=[focal_px, 320, 240, k1], width=640, height=480)
    return SimpleNamespace(
        reg_image_ids=lambda: range(n),
        num_reg_images=lambda: n,
        image=lambda i: SimpleNamespace(name=f"{i}.jpg", camera=camera),
        compute_mean_reprojection_error=lambda: error,
    )


@pytest.mark.parametrize(
    ("exif", "free", "held", "is_held", "overruled"),
    [
        (None, model(700, 0.3), None, False, None),
        (None, model(9000, 0.3), model(768, 0.4), True, None),  # implausible, and none given
        (TOLD, model(420, 0.3), None, False, None),  # both about the same
        (TOLD, model(300, 0.30), model(TOLD, 0.31), True, None),  # the photos do not determine it
        (TOLD, model(650, 0.2), model(TOLD, 0.7), False, Overruled(TOLD, 650, 0.7, 0.2)),
        (TOLD, model(650, 0.2), model(TOLD, 0.2, n=3), False, Overruled(TOLD, 650, None, 0.2)),
        (TOLD, model(650, 0.2, k1=0.9), model(TOLD, 0.7), True, None),
    ],
)
def test_whose_focal_length(
    exif: float | None, free: Any, held: Any, is_held: bool, overruled: Overruled | None
) -> None:
    built = choose(lambda inputs: [held if inputs else free], photos(exif))
    assert (built.models, built.held) == ([held if is_held else free], is_held)
    assert built.overruled == overruled


@pytest.mark.parametrize(("flat", "n_tries"), [(True, 1), (False, len(STEPS))])
def test_photos_from_one_place_are_tried_once(
    flat: bool, n_tries: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    built = Attempt(links=links(0.1, flat)), Try("x", 0, 0.0, 0.0, 0.0)
    monkeypatch.setattr(search, "attempt", lambda *_: built)
    message: Any = SimpleNamespace(label="", say=lambda _: None)
    assert len(search._best(STEPS, photos(None), tmp_path, 1, message)[1]) == n_tries


def test_lower_thresholds_where_photos_are_left_over(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[bool, bool]] = []

    def mapping(step: object, low: bool, held: bool) -> tuple[bool, bool]:
        return low, held

    def mapped(options: tuple[bool, bool], *_: object) -> list[Any]:
        asked.append(options)
        return [model(700, 0.3, n=3 if not options[0] else 4)]

    monkeypatch.setattr(placing, "mapping", mapping)
    monkeypatch.setattr(placing, "_models", mapped)
    with Path("/dev/null").open("w") as out:
        built = placing.place(STEPS[0], photos(None), Path(), Path(), Messages(out, 9.0))
    assert built.size == 4 and asked == [(False, False), (True, False)]


def test_nothing_placed_by_the_given_one() -> None:
    free = model(650, 0.2)
    built = choose(lambda inputs: [] if inputs else [free], photos(TOLD))
    assert built.models == [free] and built.overruled == Overruled(TOLD, 650, None, 0.2)
    assert choose(lambda inputs: [], photos(TOLD)).size == 0
    assert choose(lambda inputs: [] if inputs else [model(9000, 0.2)], photos(None)).size == 0
