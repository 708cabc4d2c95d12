"""A study with a forged or broken run: its report lists that run in a line and all the others."""

import io
import json
import os
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from framework.command.cli import main as command
from framework.errors import UserError
from framework.report.build import build_report
from framework.report.study.collect import collect
from tests.record.fakes import fake_run

Forge = Callable[[Path], object]
FAILURE = '{"error": "no overlap", "kind": "bad input", "overrides": ["seed=1"]}'
MANY = "x" * 100_000


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two seeds of two methods, and the run `x` to be forged."""
    study = tmp_path_factory.mktemp("sound")
    for seed in range(2):
        fake_run(study, seed=seed)
        fake_run(study, "safi", seed=seed)
    fake_run(study, "none", "uar", run_name="x")
    return study


@pytest.fixture
def study(sound: Path, tmp_path: Path) -> Path:
    shutil.copytree(sound, tmp_path / "study")
    return tmp_path / "study"


def _record(change: Callable[[Any], object]) -> Forge:
    def forge(run: Path) -> None:
        record = json.loads((run / "record.json").read_text())
        change(record)
        (run / "record.json").write_text(json.dumps(record))

    return forge


def _config(**options: Any) -> Forge:
    return _record(lambda record: record["config"].update(options))


def _scene(name: str, **more: Any) -> Forge:
    def change(record: Any) -> None:
        record["scene"].update(name=name, fingerprint="0f" * 32)
        record.update(more)

    return _record(change)


def _failed(text: str) -> Forge:
    """A folder with `failed.json` alone."""

    def forge(run: Path) -> None:
        shutil.rmtree(run)
        run.mkdir()
        (run / "failed.json").write_text(text)

    return forge


def _pipe(name: str) -> Forge:
    def forge(run: Path) -> None:
        (run / name).unlink(missing_ok=True)
        os.mkfifo(run / name)

    return forge


def _pictures(width: int, height: int) -> Forge:
    buffer = io.BytesIO()
    Image.new("RGB", (width, height)).save(buffer, "PNG")
    return lambda run: [p.write_bytes(buffer.getvalue()) for p in (run / "renders").iterdir()]


def _cell(name: str, column: str, text: str) -> Forge:
    def forge(run: Path) -> None:
        heads, first, *rest = (run / name).read_text().splitlines()
        cells = first.split(",")
        cells[heads.split(",").index(column)] = text
        (run / name).write_text("\n".join([heads, ",".join(cells), *rest]) + "\n")

    return forge


DAMAGED: dict[str, tuple[Forge, str]] = {
    "brackets": (_failed("[" * 100_000), "failed.json: expected JSON"),
    "types": (_failed('{"error": 1, "overrides": []}'), "error is '1'"),
    "no file": (lambda run: _pipe("failed.json")(_emptied(run)), "a pipe"),
    "trainer text": (_config(trainer="x"), "config.trainer is 'x'"),
    "packages": (_record(lambda r: r["provenance"].update(packages=[1])), "provenance.packages"),
    "surrogate": (_scene("\udcff"), "expected whole characters"),
    "long text": (_scene(MANY), "texts of at most 10,000 characters, got 100,000"),
    "markup as hash": (_scene("a", parameters_sha256="`<b>"), "parameters_sha256 is"),
    "huge number": (
        _record(lambda r: r["summary"]["psnr"].update(mean=1e300)),
        "summary.psnr is",
    ),
    "record pipe": (_pipe("record.json"), "record.json: expected a regular file, got a pipe"),
    "infinite PSNR": (_cell("metrics.csv", "psnr", "inf"), "psnr is 'inf'"),
    "long view": (_cell("metrics.csv", "view", "v" * 300), "view is 'vvv"),
}


def _emptied(run: Path) -> Path:
    shutil.rmtree(run)
    run.mkdir()
    return run


def test_damaged_runs_are_a_line_each_among_the_failures(study: Path) -> None:
    for name, (forge, _) in DAMAGED.items():
        run = study / "runs" / name.replace(" ", "_")
        shutil.copytree(study / "runs" / "x", run)
        forge(run)
    start = time.process_time()
    text = build_report(study).path.read_text(encoding="utf-8")
    assert time.process_time() - start < 10
    lines = [line for line in text.splitlines() if "| damaged |" in " ".join(line.split())]
    rows = {name: [row for row in lines if name.replace(" ", "_") in row] for name in DAMAGED}
    for name, (_, message) in DAMAGED.items():
        (row,) = rows[name]
        assert message in row.replace("\\", "") and str(study) not in row, name
        assert "fishersplat " not in row, name
    assert f"{len(DAMAGED)} of {len(DAMAGED) + 5} runs failed" in text
    _has_the_sound_runs(text)


def _has_the_sound_runs(text: str) -> None:
    for method in ("none-none", "safi-none"):
        assert text.count(f"(runs/embedded-{method}-s") == 2


ODD: dict[str, Forge] = {
    "mathtext": _scene("$\\frac{$ $x_{$"),
    "markup": _scene("<b>`|[x](y)</b>\u202e\x1b[2J"),
    "a long name": _scene("y" * 250),
    "odd options": _config(augment={"name": "a", "x": [1, {"y": None}], "weight": True}),
    "bytes in its name": lambda run: os.rename(run, os.fsencode(run) + b"\xff`|<i>$"),
    "no times": _record(lambda r: r.update(timings=[], summary={})),
    "zeros": _record(lambda r: r.update(gaussians=0, ply_bytes=0, peak_memory_bytes=0)),
    "no rows": lambda run: [
        (run / t).write_text((run / t).read_text().splitlines()[0] + "\n")
        for t in ("metrics.csv", "history.csv")
    ],
    "failed beside": lambda run: (run / "failed.json").write_text("[" * 100_000),
    "plain failure": _failed(FAILURE),
}


def test_odd_runs_break_no_report(study: Path) -> None:
    for seed, forge in enumerate(ODD.values(), 10):
        forge(fake_run(study, "none", "uar", seed, run_name=f"x{seed}"))
    text = build_report(study).path.read_text(encoding="utf-8")
    page = (study / "report.html").read_text(encoding="utf-8")
    assert "<b>" not in page and "<i>" not in page and "\x1b" not in text + page
    assert all(len(os.fsencode(path.name)) < 200 for path in study.iterdir())
    _has_the_sound_runs(text)


@pytest.mark.parametrize(
    ("forge", "message"),
    [
        (lambda run: (run / "renders/test_01.png").unlink(), "expected a file or folder, found"),
        (_pictures(1, 60_000), "sides of at most 1:40, got 1x60000"),
        (_pictures(50, 50), "expected .* as the photo, got 50x50"),
    ],
)
def test_a_damaged_picture_ends_the_report_in_one_line(
    study: Path, forge: Forge, message: str
) -> None:
    forge(study / "runs" / "x")
    with pytest.raises(UserError, match=message) as caught:
        build_report(study)
    assert "\n" not in str(caught.value) and "runs/x/renders" in str(caught.value)


def test_folders_without_end(tmp_path: Path) -> None:
    fake_run(tmp_path)
    (tmp_path / "runs" / "round").symlink_to(tmp_path)
    inner = Path.cwd()
    os.chdir(tmp_path)
    try:
        for _ in range(1200):  # a path that no call can name, deeper than Python's stack
            os.mkdir("deep")
            os.chdir("deep")
    finally:
        os.chdir(inner)
    assert len(collect(tmp_path).runs) == 1
    assert os.system(f"rm -rf '{tmp_path}/deep'") == 0


@pytest.mark.parametrize("where", ["file", "file/below", "x" * 300, "proc"])
def test_a_report_that_cannot_be_written(
    study: Path, capsys: pytest.CaptureFixture[str], where: str
) -> None:
    (study / "file").write_text("")
    out = Path("/proc/here") if where == "proc" else study / where
    assert command(["report", str(study), "--out", str(out)]) == 2
    message = capsys.readouterr().err
    assert message.startswith("error: ") and message.count("\n") == 1 and "Traceback" not in message
