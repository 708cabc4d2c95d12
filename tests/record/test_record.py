"""Records: whole or not at all, strict JSON, exact tables, identity, torch-free reading."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from framework.errors import UserError
from framework.files import whole as files
from framework.files.whole import following, write_whole
from framework.metrics.evaluate import evaluate_view, psnr
from framework.metrics.values import Missing
from framework.records import provenance, record
from framework.records.ply import read_ply
from framework.records.record import find_complete, read_record, read_run, write_failed, write_run
from framework.records.run_files import ERROR_SCALE, error_map, file_stems
from tests.record.fakes import fake_run, make_config, make_gaussians, make_view, noisy


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


def test_numbers_in_the_tables_are_exact(run_dir: Path) -> None:
    view = make_view(0)
    expected = evaluate_view(view, noisy(view, 30.0, "x", 0))
    stored = read_run(run_dir).metrics
    recomputed = [saved_psnr(run_dir, name) for name in stored.texts["file"]]
    assert list(stored.numbers["psnr"]) == recomputed
    assert isinstance(expected.psnr, float)


def saved_psnr(run_dir: Path, stem: str) -> float:
    """PSNR of the two PNG files of a view."""
    planar = [
        torch.from_numpy(np.array(Image.open(run_dir / "renders" / name))).permute(2, 0, 1) / 255.0
        for name in (f"{stem}.png", f"{stem}_truth.png")
    ]
    value = psnr(*planar)
    assert isinstance(value, float)
    return value


def test_json_is_strict_and_nan_is_explained(tmp_path: Path) -> None:
    run_dir = fake_run(tmp_path)
    view = make_view(0)
    perfect = evaluate_view(view, view.image)
    old = read_record(run_dir / "record.json")
    config = {**old.config, "stop": float("nan")}
    write_run(
        run_dir,
        replace(old, config=config),
        [perfect],
        [],
        make_gaussians(2, 0),
        torch.zeros(3),
        [(view, view.image)],
    )

    def refuse(constant: str) -> None:
        raise AssertionError(constant)

    content = json.loads((run_dir / "record.json").read_text(), parse_constant=refuse)
    assert content["summary"]["psnr"]["mean"] is None
    assert content["summary"]["psnr"]["missing"] == "infinite: render equals truth"
    assert content["config"]["stop"] is None
    assert np.isnan(read_run(run_dir).metrics.numbers["psnr"]).all()
    assert sorted(p.name for p in (run_dir / "renders").iterdir()) == [
        "test_00.png",
        "test_00_error.png",
        "test_00_truth.png",
    ]


def test_an_interrupted_rewrite_is_not_complete(
    run_dir: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    old = read_record(run_dir / "record.json")
    assert find_complete(run_dir, old.identity) == old
    view = make_view(0)

    def killed(*_: object) -> str:
        raise KeyboardInterrupt

    monkeypatch.setattr(record, "history_csv", killed)
    with pytest.raises(KeyboardInterrupt):
        write_run(
            run_dir,
            old,
            [evaluate_view(view, view.image)],
            [],
            make_gaussians(2, 0),
            torch.zeros(3),
            [(view, view.image)],
        )
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


def test_damaged_table_is_one_line(run_dir: Path) -> None:
    table = run_dir / "history.csv"
    table.write_text(table.read_text()[:-9])
    with pytest.raises(UserError, match="damaged"):
        read_run(run_dir)


def test_damaged_record_is_one_line(run_dir: Path) -> None:
    (run_dir / "record.json").write_text('{"status": "comp')
    assert find_complete(run_dir, "x") is None
    with pytest.raises(UserError, match="expected JSON") as caught:
        read_run(run_dir)
    assert "\n" not in str(caught.value)
    with pytest.raises(UserError, match="found none"):
        read_run(run_dir / "nothing")


def test_doses_are_read_and_flat(run_dir: Path) -> None:
    path = run_dir / "record.json"
    content = json.loads(path.read_text())
    assert read_record(path).dose == {}
    path.write_text(json.dumps({k: v for k, v in content.items() if k != "dose"}))
    assert read_record(path).dose == {}  # written before doses
    dose = {"views_asked": 42, "coverage_mean": 0.4, "how": "text", "none": None}
    path.write_text(json.dumps(content | {"dose": dose}))
    assert read_record(path).dose == dose
    record.write_record(run_dir, replace(read_record(path), dose=dose))
    assert read_record(path).dose == dose
    for wrong in ({"a": [1]}, {"a": "two\nlines"}, {"two\nlines": 1}, [1], None):
        path.write_text(json.dumps(content | {"dose": wrong}))
        with pytest.raises(UserError, match="dose"):
            read_record(path)


def test_failed_runs_are_recorded(tmp_path: Path) -> None:
    write_failed(tmp_path, make_config(seed=4), ["seed=4"], "UserError: depth:\n no overlap")
    run = read_run(tmp_path)
    assert run.record.status == "failed" and run.record.error == "UserError: depth: no overlap"
    assert run.record.seed == 4 and not run.metrics.numbers
    assert find_complete(tmp_path, "") is None


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


def test_provenance_is_strict_json_without_host_facts() -> None:
    text = provenance.strict_json(provenance.provenance())
    facts = json.loads(text)
    assert facts["cpu"] and facts["threads"] >= 1 and len(facts["code"]) == 64
    assert (facts["packages"]["torch"] and facts["git"] is None) or len(facts["git"]["sha"]) == 40
    import platform

    assert str(provenance.ROOT) not in text and f'"{platform.node()}"' not in text


def test_no_git_state_outside_a_checkout(tmp_path: Path) -> None:
    assert provenance.git_state(tmp_path) is None


def test_a_checkout_is_dirty_by_what_makes_results_alone(tmp_path: Path) -> None:
    package = tmp_path / "framework"
    package.mkdir()
    (package / "__init__.py").touch()
    words = ["-c", "user.name=a", "-c", "user.email=a@b"]
    for line in (["init", "-q"], ["add", "."], [*words, "commit", "-qm", "first"]):
        subprocess.run(["git", "-C", str(tmp_path), *line], check=True)
    (tmp_path / "notes.md").write_text("mine", encoding="utf-8")
    state = provenance.git_state(tmp_path)
    assert state is not None and not state["dirty"]
    (package / "new.py").touch()
    state = provenance.git_state(tmp_path)
    assert state is not None and state["dirty"]


def test_an_installed_copy_inside_a_foreign_checkout_has_no_git_state(tmp_path: Path) -> None:
    subprocess.run(["git", "init", "-q", str(tmp_path)], check=True)
    (tmp_path / "framework").mkdir()
    (tmp_path / "framework" / "__init__.py").write_text("")
    assert provenance.git_state(tmp_path) is None


def test_file_names_are_safe_and_distinct() -> None:
    assert file_stems(["a/b", "a b", "../x", ""]) == ["a_b", "a_b-2", "_x", "view"]
    assert file_stems(["A", "a", "b_truth", "b", "a"]) == ["A", "a-2", "b_truth", "b-2", "a-3"]


def test_error_map_scale() -> None:
    truth = np.zeros((1, 3, 3), np.uint8)
    render = np.array([[[0] * 3, [32] * 3, [200] * 3]], np.uint8)
    import matplotlib

    magma = matplotlib.colormaps["magma"]
    expected = [magma(x, bytes=True)[:3] for x in (0.0, 32 / 255 / ERROR_SCALE, 1.0)]
    np.testing.assert_allclose(error_map(render, truth)[0], np.array(expected, int), atol=1)


def test_masks_are_saved(tmp_path: Path) -> None:
    from framework.records.run_files import write_renders

    view = replace(make_view(0), mask=torch.ones(48, 64))
    write_renders(tmp_path, ["v"], [(view, view.image)])
    assert np.array(Image.open(tmp_path / "v_mask.png")).min() == 255


def test_peak_memory_is_plausible() -> None:
    assert provenance.peak_memory_bytes() > 10_000_000


def test_reading_needs_no_torch(run_dir: Path) -> None:
    code = (
        "import sys; from pathlib import Path; from framework.records.record import read_run;"
        f"read_run(Path({str(run_dir)!r})); assert 'torch' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=provenance.ROOT)


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
    shown, measured = [(view, view.image)], [evaluate_view(view, view.image)]
    rest = make_gaussians(2, 0), torch.zeros(3), shown, before
    write_run(run_dir, old, measured, [], *rest)
    assert find_complete(run_dir, old.identity) is None
    monkeypatch.undo()
    write_run(run_dir, old, measured, [], *rest[:3])
    assert find_complete(run_dir, old.identity) is not None
