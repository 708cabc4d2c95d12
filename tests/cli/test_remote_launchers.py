"""Runs sent to other processes by submitit and Ray, and studies that outlive their command."""

from __future__ import annotations

import json
import os
import signal
import site
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from hydra.errors import MissingConfigException

from benchmarks.studies import digests, leftovers
from framework.command import cli
from framework.command.complaints import one_line
from framework.command.config.schema import ROOT
from framework.command.launchers import known, page, plan
from framework.command.launchers.plan import Plan, new_plan, read_plan, work
from framework.command.launchers.sent import lead_to_this_code
from framework.command.studies.study import (
    JOBS_VARIABLE,
    LEDGER_VARIABLE,
    VARIED_VARIABLE,
    Outcome,
    add_outcome,
)
from framework.errors import UserError
from tests.cli.conftest import FakeRuns

SMALL = (
    "threads=1 depth=ground_truth init.budget=300 scene.width=64 scene.height=48"
    " scene.supersampling=1 trainer.steps=12 trainer.evaluations=1 study=far"
)
SUBMITIT = "hydra_plugins.hydra_submitit_launcher"
RAY = "hydra_plugins.hydra_ray_launcher"
LOCAL = "hydra/launcher=submitit_local hydra.launcher.n_jobs=2"
RAY_HERE = "hydra/launcher=ray +hydra.launcher.ray.init.num_cpus=2"


def command(folder: Path, line: str, **keywords: object) -> subprocess.CompletedProcess[str]:
    folder.mkdir(exist_ok=True)
    return subprocess.run(
        [sys.executable, str(ROOT / "run.py"), *line.split()],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=300,
        **keywords,  # type: ignore[call-overload, no-any-return]
    )


def wait_for(condition: Callable[[], object], seconds: float = 240) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.2)


@pytest.fixture(scope="module")
def expected(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """What one process makes of the study."""
    folder = tmp_path_factory.mktemp("here")
    done = command(folder, f"{SMALL} seed=0,1 -m")
    assert done.returncode == 0, done.stderr
    return digests(folder / "reports" / "far")


def test_ray_makes_the_same_bytes(tmp_path: Path, expected: dict[str, str]) -> None:
    pytest.importorskip(RAY, reason="ray is an extra")
    done = command(tmp_path, f"{SMALL} {RAY_HERE} seed=0,1 -m")
    assert done.returncode == 0, done.stderr
    assert digests(tmp_path / "reports" / "far") == expected
    assert not leftovers(tmp_path / "reports" / "far")
    assert "2 of 2 ended" in done.stdout and done.stdout.count("report: ") == 1


def test_processes_run_the_code_that_the_command_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not that which is installed; what was on the path before stays behind it."""
    (tmp_path / "framework").mkdir()
    (tmp_path / "framework" / "__init__.py").write_text("")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(["/elsewhere", str(tmp_path)]))
    lead_to_this_code(tmp_path)
    assert os.environ["PYTHONPATH"] == os.pathsep.join([str(tmp_path), "/elsewhere"])
    told = [sys.executable, "-c", "import framework; print(framework.__file__)"]
    found = subprocess.run(told, cwd="/", capture_output=True, text=True, check=True).stdout
    assert found.strip() == str(tmp_path / "framework" / "__init__.py")


def test_code_in_site_packages_needs_no_path(monkeypatch: pytest.MonkeyPatch) -> None:
    """In front of Python's own modules it would hide some."""
    monkeypatch.delenv("PYTHONPATH", raising=False)
    lead_to_this_code(Path(site.getsitepackages()[0]).resolve())
    assert "PYTHONPATH" not in os.environ


@pytest.mark.parametrize(("module", "words"), [(SUBMITIT, LOCAL), (RAY, RAY_HERE)])
def test_failures_elsewhere_reach_the_table(tmp_path: Path, module: str, words: str) -> None:
    pytest.importorskip(module, reason=f"{module} is an extra")
    (tmp_path / "empty").mkdir()
    done = command(
        tmp_path, f"{words} seed=0,1 scene=llff scene.path=empty depth=plane_sweep study=far -m"
    )
    assert done.returncode == 2, done.stderr
    assert "2 of 2 runs failed" in done.stderr and "Traceback" not in done.stderr
    assert "seed=1" in done.stderr and "launcher" not in done.stderr  # how to do one alone
    records = (tmp_path / "reports" / "far" / "runs").glob("*/record.json")
    assert [json.loads(path.read_text())["status"] for path in records] == ["failed", "failed"]


def test_a_killed_process_costs_one_run_and_no_byte(
    tmp_path: Path, expected: dict[str, str]
) -> None:
    """The other ends, the report is built, the same command does the lost one again."""
    pytest.importorskip(SUBMITIT, reason="submitit is an extra")
    line = f"{SMALL} {LOCAL} seed=0,1 -m"
    with subprocess.Popen(
        [sys.executable, str(ROOT / "run.py"), *line.split()],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as running:
        wait_for(lambda: holders(tmp_path))
        os.kill(holders(tmp_path)[0], signal.SIGKILL)
        out, err = running.communicate(timeout=300)
    assert running.returncode == 1
    assert "1 runs ended without telling how" in err and "lost: " in out and "report: " in out
    again = command(tmp_path, line)
    assert again.returncode == 0, again.stderr
    assert "2 of 2 ended" in again.stdout
    study = tmp_path / "reports" / "far"
    assert digests(study) == expected and not leftovers(study)
    assert len(list((tmp_path / "reports").glob(".submitit-*"))) == 1, "the log of what was lost"


def holders(folder: Path) -> list[int]:
    """The processes that are at a run."""
    texts = [path.read_text() for path in (folder / "reports").glob("*/runs/*/.lock.holder")]
    return [int(json.loads(text)["pid"]) for text in texts if text]


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("hydra/launcher=submitit_slurm +hydra.launcher.setup=[ls]", "hydra.launcher.setup"),
        ("hydra/launcher=submitit_local hydra.launcher.submitit_folder=x", "submitit_folder"),
        ("hydra/launcher=submitit_slurm 'hydra.launcher.partition=\"a b\"'", "partition"),
        ("hydra/launcher=submitit_local hydra.launcher.n_jobs=0", "hydra.launcher.n_jobs"),
    ],
)
def test_what_a_launcher_may_not_be_told(
    runs: FakeRuns, capsys: pytest.CaptureFixture[str], words: str, expected: str
) -> None:
    pytest.importorskip(SUBMITIT, reason="submitit is an extra")
    import shlex

    assert cli.main([*shlex.split(words), "-m"]) == 2
    assert expected in capsys.readouterr().err and not runs.seen


@pytest.mark.parametrize("name", ["submitit_slurm", "submitit_local", "ray"])
def test_no_file_chooses_a_launcher_that_goes_elsewhere(
    runs: FakeRuns, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    pytest.importorskip(known.LAUNCHERS[name].needs, reason=f"{name} is an extra")
    Path("own/experiment").mkdir(parents=True)
    Path("own/experiment/far.yaml").write_text(
        f"# @package _global_\ndefaults:\n  - override /hydra/launcher: {name}\n"
    )
    search = f"hydra.searchpath=[file://{Path('own').resolve()}]"
    assert cli.main([search, "experiment=far", "-m"]) == 2
    assert "on the command line only" in capsys.readouterr().err and not runs.seen


def test_a_missing_extra_is_named(
    runs: FakeRuns, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(known, "_installed", lambda module: False)
    assert known.missing_extra("ray") == "ray" and known.missing_extra("joblib") is None
    assert cli.main(["study", "submit", "seed=0,1"]) == 2
    assert "pip install 'fishersplat[submitit]'" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "told"),
    [
        (
            "ray",
            "hydra-ray-launcher to be installed, found it missing; pip install 'fishersplat[ray",
        ),
        (
            "submitit_slurm",
            "hydra-submitit-launcher to be installed, found it missing; pip install",
        ),
        ("rya", "unknown hydra/launcher; available: basic, joblib, ray, submitit_local, "),
    ],
)
def test_the_package_of_a_missing_launcher_is_named(
    monkeypatch: pytest.MonkeyPatch, name: str, told: str
) -> None:
    monkeypatch.setattr(known, "_installed", lambda module: False)
    error = MissingConfigException("", f"hydra/launcher/{name}", ["basic", "joblib"])
    assert told in one_line(error)


# plans, without processes


def outcome(number: int, folder: Path, error: str | None = None) -> Outcome:
    return Outcome(number, str(folder / "far" / "runs" / f"r{number}"), error)


def a_plan(tmp_path: Path, n_runs: int = 4) -> Plan:
    return new_plan(
        tmp_path, "study submit seed=...", "local", [(i, [f"seed={i}"]) for i in range(n_runs)]
    )


def test_the_newest_submission_is_the_last_one_made(tmp_path: Path) -> None:
    first, second = a_plan(tmp_path), a_plan(tmp_path)
    (first.folder / "page.html").write_text("whoever looks at it writes this")
    assert plan.plans(tmp_path) == [first.folder, second.folder]


@pytest.fixture
def no_ledger(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plan, "build_reports", lambda: None)
    for name in (LEDGER_VARIABLE, JOBS_VARIABLE, VARIED_VARIABLE):
        monkeypatch.setenv(name, "")


def test_workers_share_the_runs(tmp_path: Path, no_ledger: None) -> None:
    submitted, done = a_plan(tmp_path), list[int]()

    def do(run: plan.Run) -> Outcome:
        done.append(run[0])
        if run[0] == 1:
            work(read_plan(submitted.folder), do, lambda: None)  # a second worker, meanwhile
        result = outcome(run[0], tmp_path, "broken" if run[0] == 2 else None)
        add_outcome(result)
        return result

    work(submitted, do, lambda: None)
    assert sorted(done) == [0, 1, 2, 3], "nothing lost or doubled"
    assert (submitted.folder / plan.REPORTED).exists()
    now = page.status(submitted)
    assert (now.counts["done"], now.counts["failed"], now.counts["waiting"]) == (3, 1, 0)
    assert "broken" in page.page(submitted, now) and "http-equiv=refresh" not in page.page(
        submitted, now
    )
    assert not list((submitted.folder / "claims").iterdir())


def test_a_run_of_a_lost_worker_is_taken_up(tmp_path: Path, no_ledger: None) -> None:
    submitted, tries = a_plan(tmp_path, 2), list[int]()

    def do(run: plan.Run) -> Outcome:
        tries.append(run[0])
        result = outcome(run[0], tmp_path)
        if len(tries) > 1:
            add_outcome(result)
        return result

    (submitted.claim(0)).mkdir(parents=True)
    (submitted.claim(0) / ".lock").touch()  # as a killed worker leaves it
    work(submitted, do, lambda: None)
    assert tries == [0, 1, 0]


def test_cancel_interrupts_and_forgets_nothing(tmp_path: Path, no_ledger: None) -> None:
    submitted = a_plan(tmp_path)

    def do(run: plan.Run) -> Outcome:
        if run[0] == 1:
            (submitted.folder / plan.CANCELLED).touch()
            time.sleep(30)
        add_outcome(outcome(run[0], tmp_path))
        return outcome(run[0], tmp_path)

    work(submitted, do, lambda: None)
    assert list(submitted.ended()) == [0]
    work(submitted, do, lambda: None)  # a worker that waited in the queue
    assert (
        list(submitted.ended()) == [0]
        and "cancelled" in page.told(submitted, page.status(submitted))[0]
    )


@pytest.mark.parametrize(
    "content",
    [
        "[]",
        '{"command": "x", "engine": "slurm", "jobs": ["1; rm"], "runs": []}',
        '{"command": "x", "engine": "ssh", "jobs": [], "runs": []}',
        '{"command": "x", "engine": "slurm", "jobs": [], "runs": [[0, [1]]]}',
    ],
)
def test_a_forged_plan_is_refused(tmp_path: Path, content: str) -> None:
    (tmp_path / plan.PLAN).write_text(content)
    with pytest.raises(UserError, match="expected a plan"):
        read_plan(tmp_path)


def test_a_forged_outcome_is_refused(tmp_path: Path) -> None:
    submitted = a_plan(tmp_path)
    text = json.dumps(vars(outcome(0, tmp_path.parent / "elsewhere")))
    (submitted.ledger / "000000.json").write_text(text)
    with pytest.raises(UserError, match="expected the outcome of a run of this study"):
        submitted.ended()


def test_submitted_polled_collected(tmp_path: Path) -> None:
    pytest.importorskip(SUBMITIT, reason="submitit is an extra")
    done = command(tmp_path, f"study submit {SMALL} hydra.launcher.n_jobs=1 seed=0")
    assert done.returncode == 0, done.stderr
    assert "of 1 runs done" in done.stdout and "report: " not in done.stdout
    (folder,) = plan.plans(tmp_path / "reports")
    wait_for((folder / plan.REPORTED).exists)
    told = command(tmp_path, "study status")
    assert "all ended, 1 of 1 runs done, 0 failed" in told.stdout
    assert (tmp_path / "reports" / "far" / "report.md").exists()
    collected = command(tmp_path, "study collect")
    assert collected.returncode == 0 and "report: reports/far/report.md" in collected.stdout


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("study status", "expected a submitted study, found none"),
        ("study submit hydra/launcher=ray seed=0,1", "ray job submit"),
    ],
)
def test_study_in_one_line(
    runs: FakeRuns, capsys: pytest.CaptureFixture[str], line: str, expected: str
) -> None:
    assert cli.main(line.split()) == 2
    assert expected in capsys.readouterr().err
