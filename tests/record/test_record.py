"""Records: whole or not at all, strict JSON, exact tables, identity."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from framework.errors import UserError
from framework.files import whole as files
from framework.files.whole import following, write_whole
from framework.metrics.values import Missing
from framework.records import provenance, record
from framework.records.ply import read_ply
from framework.records.record import find_complete, read_record, read_run, write_run
from framework.records.run_files import file_stems
from tests.record.fakes import fake_run, make_config, make_gaussians, make_view, measured


@pytest.fixture()
def run_dir(tmp_path: Path) -> Path:
    return fake_run(tmp_path, "safi", "uar", seed=2, bits=0.5)


def test_a_run_reads_back(run_dir: Path) -> None:
    run = read_run(run_dir)
    assert run.record.status == "complete"
    assert run.record.seed == 2 and run.record.gaussians == 12 and run.record.sh_degree == 0
    assert run.record.methods["augment"] == "safi" and run.record.methods["init"] == "stereo"
    assert run.record.train_s == 16.25 and run.record.parameters == 12 * 14
    written = make_gaussians(12, 0)
    written.means[0, 0] = 0.5
    assert run.record.parameters_sha256 == record.parameters_sha256(written)
    assert run.record.ply_bytes == (run_dir / "point_cloud.ply").stat().st_size
    assert run.record.summary["psnr"] == pytest.approx(
        run.metrics.numbers["psnr"].mean(), abs=1e-12
    )
    assert isinstance(run.record.summary["lpips"], Missing)
    assert "metrics.lpips_weights" in json.loads(run.metrics.texts["missing"][0])["lpips"]
    assert np.isnan(run.metrics.numbers["lpips"]).all()
    assert list(run.metrics.texts["tags"]) == ["interpolating"] * 2 + ["extrapolating"] * 2
    assert list(run.history.numbers["step"]) == list(range(100, 801, 100))
    assert np.isfinite(run.history.numbers["test_psnr"]).sum() == 4
    assert (run.history.numbers["log/dropped"] == 0.1).all()
    assert read_ply(run_dir / "point_cloud.ply")[1] is not None


def test_json_is_strict_and_nan_is_explained(tmp_path: Path) -> None:
    run_dir = fake_run(tmp_path)
    view = make_view(0)
    perfect = measured(view, view.image)
    old = read_record(run_dir / "record.json")
    config = {**old.config, "stop": float("nan")}
    rest = make_gaussians(2, 0), torch.zeros(3), [(view, view.image)]
    write_run(run_dir, replace(old, config=config), [perfect], [], *rest)

    def refuse(constant: str) -> None:
        raise AssertionError(constant)

    content = json.loads((run_dir / "record.json").read_text(), parse_constant=refuse)
    assert content["summary"]["psnr"]["mean"] is None
    assert content["summary"]["psnr"]["missing"] == "infinite: render equals truth"
    assert content["config"]["stop"] is None
    assert np.isnan(read_run(run_dir).metrics.numbers["psnr"]).all()
    pictures = sorted(p.stem for p in (run_dir / "renders").iterdir())
    assert pictures == ["test_00", "test_00_error", "test_00_truth"]


def test_an_interrupted_rewrite_is_not_complete(
    run_dir: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    old = read_record(run_dir / "record.json")
    assert find_complete(run_dir, old.identity) == old
    view = make_view(0)

    rest = make_gaussians(2, 0), torch.zeros(3), [(view, view.image)]

    def killed(*_: object) -> str:
        raise KeyboardInterrupt

    monkeypatch.setattr(record, "history_csv", killed)
    with pytest.raises(KeyboardInterrupt):
        write_run(run_dir, old, [measured(view, view.image)], [], *rest)
    assert find_complete(run_dir, old.identity) is None
    assert not [p for p in run_dir.rglob("*") if p.name.endswith(".tmp")]


def test_find_complete_wants_the_same_identity_and_all_files(run_dir: Path) -> None:
    identity = read_record(run_dir / "record.json").identity
    assert find_complete(run_dir, identity) is not None
    assert find_complete(run_dir, "another") is None
    (run_dir / "metrics.csv").unlink()
    assert find_complete(run_dir, identity) is None
    with pytest.raises(UserError, match=r"metrics\.csv"):
        read_run(run_dir)


def test_damaged_record_is_one_line(run_dir: Path) -> None:
    (run_dir / "record.json").write_text('{"status": "comp')
    assert find_complete(run_dir, "x") is None
    with pytest.raises(UserError, match="expected JSON") as caught:
        read_run(run_dir)
    assert "\n" not in str(caught.value)
    with pytest.raises(UserError, match="found none"):
        read_run(run_dir / "nothing")


def test_identity_ignores_what_cannot_change_the_result() -> None:
    base, files = make_config(), {"depth": "", "lpips_weights": ""}
    identity = provenance.identity_of(base, "scene", "code", files)
    neutral = {**base, "threads": 3, "force": True, "study": "x", "traceback": True}
    neutral["tracker"] = "tensorboard"
    assert provenance.identity_of(neutral, "scene", "code", files) == identity
    others = [
        provenance.identity_of(make_config(seed=1), "scene", "code", files),
        provenance.identity_of(make_config(trainer={"steps": 801}), "scene", "code", files),
        provenance.identity_of(base, "other", "code", files),
        provenance.identity_of(base, "scene", "other", files),
        provenance.identity_of(base, "scene", "code", {**files, "depth": "other"}),
        provenance.identity_of(base, "scene", "code", {**files, "lpips_weights": "other"}),
    ]
    assert len({identity, *others}) == 7


def test_file_names_are_safe_and_distinct() -> None:
    assert file_stems(["a/b", "a b", "../x", ""]) == ["a_b", "a_b-2", "_x", "view"]
    assert file_stems(["A", "a", "b_truth", "b", "a"]) == ["A", "a-2", "b_truth", "b-2", "a-3"]


@pytest.mark.parametrize(
    ("disturbed", "got"),
    [
        ("renders/test_00.png", "nothing"),
        ("renders", "nothing"),
        ("photos/train.jpg", "nothing"),
        ("point_cloud.ply", "0 bytes"),
        ("metrics.csv", "other ones"),
    ],
)
def test_a_run_whose_files_go_while_it_is_written_is_not_complete(
    run_dir: Path, monkeypatch: pytest.MonkeyPatch, disturbed: str, got: str
) -> None:
    """The same command repeats it."""
    old = read_record(run_dir / "record.json")
    view = make_view(0)

    def meanwhile(rows: object) -> str:
        path = run_dir / disturbed
        if path.is_dir():
            shutil.rmtree(path)
        elif got == "nothing":
            path.unlink()
        else:
            path.write_bytes(b"" if got == "0 bytes" else b"x" * path.stat().st_size)
        return "step\n"

    with following(run_dir) as before:
        write_whole(run_dir / "photos" / "train.jpg", b"a photo")
    monkeypatch.setattr(record, "history_csv", meanwhile)
    shown, metrics = [(view, view.image)], [measured(view, view.image)]
    rest = make_gaussians(2, 0), torch.zeros(3), shown, before
    write_run(run_dir, old, metrics, [], *rest)
    assert find_complete(run_dir, old.identity) is None
    monkeypatch.undo()
    write_run(run_dir, old, metrics, [], *rest[:3])
    assert find_complete(run_dir, old.identity) is not None


def test_write_whole_leaves_the_old_file_on_failure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.txt"
    files.write_whole(path, "old")

    def fail(*_: object) -> None:
        raise OSError("disk full")

    monkeypatch.setattr("os.replace", fail)
    with pytest.raises(OSError, match="disk full"):
        files.write_whole(path, "new")
    assert path.read_text() == "old" and [p.name for p in tmp_path.iterdir()] == ["a.txt"]
