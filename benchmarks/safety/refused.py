"""What once ended in a traceback, a hang or nonsense, given again by the command line. Exits with 1
if anything does.

A review gave 572 bad inputs by hand; 24 ended in a traceback, 4 in a hang, and one study could
never be reported. Each kind of them is here: what is wrong is made, the command is given in a
process of its own, and its end is judged. Refused is: exit code 2 and one line, within 5 s of CPU
time and 1.5 GB. A report of a study with a damaged run is built, and tells it in a row.

    python benchmarks/safety/refused.py [--only WORD] [--output benchmarks/results/refused.md]
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from benchmarks.safety.fuzz import below  # noqa: E402
from tests.metrics.test_lpips import features, state_dict  # noqa: E402
from tests.record.fakes import fake_run  # noqa: E402
from tests.scenes.synthetic import write_llff, write_scene  # noqa: E402
from tests.scenes.test_transforms import frames  # noqa: E402
from tests.scenes.test_transforms import write as write_transforms  # noqa: E402
from tests.security.test_forged_runs import DAMAGED, ODD  # noqa: E402

CPU_S, WALL_S, MEMORY_MB = 5.0, 600.0, 1500.0
MIB = 1 << 20
SMALL = [
    *("depth=ground_truth", "trainer.steps=2", "threads=1", "init.budget=100", "reg=none"),
    *("scene.width=64", "scene.height=48", "scene.supersampling=1", "trainer.evaluations=1"),
]


@dataclass(frozen=True)
class Call:
    """A command and how it must end. told: what it must say. cpu_s: None where it trains.
    address: bytes that the process may have, 0 for any. inside: variables of its environment."""

    words: list[str | bytes]
    code: int = 2
    told: str = "error: "
    cpu_s: float | None = CPU_S
    address: int = 0
    inside: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class End:
    """How a call ended: what it wrote on stderr, and what it took."""

    code: int
    stderr: str
    cpu_s: float
    memory_mb: float


Check = Callable[[Path], str]  # what is wrong in the folder afterwards; "" if nothing


def fine(_: Path) -> str:
    return ""


@dataclass(frozen=True)
class Case:
    """before: what the review saw. make(folder): the bad input; returns the calls."""

    name: str
    before: str
    make: Callable[[Path], list[Call]]
    check: Check = fine


# A small process between: a child counts the memory of the process that it was forked from.
BETWEEN = """
import json, resource, subprocess, sys
out, address, *words = sys.argv[1:]
if address != "0":
    resource.setrlimit(resource.RLIMIT_AS, (int(address), int(address)))
code = subprocess.run(words).returncode
used = resource.getrusage(resource.RUSAGE_CHILDREN)
with open(out, "w") as file:
    json.dump([code, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024], file)
"""


def give(call: Call, folder: Path) -> End:
    """One call in `folder`."""
    out = folder / "used.json"
    words: list[str | bytes] = [sys.executable, "-S", "-c", BETWEEN, str(out), str(call.address)]
    words += [sys.executable, str(ROOT / "run.py"), *call.words]
    with (folder / "err.txt").open("w+b") as err:
        child = subprocess.Popen(
            words,
            cwd=folder,
            stdout=subprocess.DEVNULL,
            stderr=err,
            env={**os.environ, **call.inside},
            start_new_session=True,
        )
        try:
            child.wait(WALL_S)
        except subprocess.TimeoutExpired:
            os.killpg(child.pid, signal.SIGKILL)
            return End(-signal.SIGKILL, "", WALL_S, 0.0)
        err.seek(0)
        told = err.read().decode(errors="replace")
    code, cpu_s, memory_mb = json.loads(out.read_text())
    return End(code, told, cpu_s, memory_mb)


def wrong(call: Call, end: End) -> str:
    """What is wrong with how a call ended; "" if nothing."""
    if "Traceback" in end.stderr:
        return "a traceback"
    if end.code != call.code:
        return f"exit code {end.code}, expected {call.code}"
    if call.code and (end.stderr.count("\n") != 1 or not end.stderr.startswith("error: ")):
        return f"not one line: {end.stderr[:300]!r}"
    if call.code and call.told not in end.stderr:
        return f"another line: {end.stderr[:300]!r}"
    if call.cpu_s is not None and end.cpu_s > call.cpu_s:
        return f"{end.cpu_s:.1f} s of CPU time"
    return f"{end.memory_mb:.0f} MB" if end.memory_mb > MEMORY_MB else ""


def line(*words: str | bytes, told: str = "error: ") -> Callable[[Path], list[Call]]:
    """A command line alone."""
    return lambda _: [Call(list(words), told=told)]


# Runs


def weights(folder: Path) -> list[Call]:
    """LPIPS weights, finite all of them, whose distances are not."""
    import torch

    state = state_dict("AlexNet", features("AlexNet"))
    huge = {name: value * 1e18 if ".weight" in name else value for name, value in state.items()}
    torch.save(huge, folder / "huge.pth")
    words = ["-m", *SMALL, "study=s", f"metrics.lpips_weights={folder / 'huge.pth'}"]
    return [Call([*words], told="no finite distance"), Call([*words], told="no finite distance")]


def begun(folder: Path) -> str:
    """Refused before anything was trained: no run is told as complete."""
    records = [json.loads(path.read_text()) for path in folder.rglob("record.json")]
    return "a complete run" if any(one["status"] == "complete" for one in records) else ""


# Reports of forged runs


def forged(change: Callable[[Path], object], folder: Path) -> list[Call]:
    """A study of two sound runs and a forged one."""
    study = folder / "study"
    fake_run(study, run_name="sound")
    fake_run(study, "safi", run_name="sound2")
    fake_run(study, "none", "uar", run_name="x")
    change(study / "runs" / "x")
    return [Call(["report", "study"], 0)]


def reported(damaged: bool, folder: Path) -> str:
    text = (folder / "study" / "report.md").read_text(encoding="utf-8")
    page = (folder / "study" / "report.html").read_text(encoding="utf-8")
    if "(runs/sound/)" not in text:
        return "the sound run is not told"
    if "<b>" in page or "<i>" in page or "\x1b" in text + page:
        return "markup of the run is in the page"
    return "the damaged run is not told" if damaged != ("damaged |" in text) else ""


def forged_case(name: str, before: str) -> Case:
    change = DAMAGED[name][0] if name in DAMAGED else ODD[name]
    check = partial(reported, name in DAMAGED)
    return Case(f"a run of a study: {name}", before, partial(forged, change), check)


def odd_lock(put: Callable[[Path, Path], object], folder: Path) -> list[Call]:
    """The lock of a study is something else: its run is done, its report is not built."""
    (folder / "precious").write_text("precious")
    (folder / "reports" / "s").mkdir(parents=True)
    put(folder / "reports" / "s" / ".lock", folder / "precious")
    words = ["-m", *SMALL, "study=s", "metrics.lpips_weights=none"]
    return [Call([*words], told="remove it and run the same again", cpu_s=None)]


def kept(folder: Path) -> str:
    """What the link led to is as it was."""
    return "" if (folder / "precious").read_text() == "precious" else "overwritten"


def linked_run(folder: Path) -> list[Call]:
    """The folder for the renders of a run is a link to another one, with a picture in it."""
    (folder / "pictures").mkdir()
    (folder / "precious").write_text("precious")
    (folder / "run").mkdir()
    (folder / "run" / "renders").symlink_to(folder / "pictures")
    return [Call([*SMALL, "hydra.run.dir=run"], told="expected no link where a run writes")]


def unwritable(folder: Path) -> list[Call]:
    forged(lambda run: None, folder)
    (folder / "file").touch()
    places = ["/proc/here", "file", "file/below", "x" * 300]
    calls = [Call(["report", "study", "--out", place]) for place in places]
    if small_disk(folder / "disk", "ro"):
        calls.append(Call(["report", "study", "--out", "disk"], told="Read-only"))
    return calls


# Scenes


def scene(name: str, folder: Path, *words: str, told: str = "error: ") -> list[Call]:
    return [Call([f"scene={name}", f"scene.path={folder}", "scene.n_views=3", *words], told=told)]


def pipe_as_photo(folder: Path) -> list[Call]:
    photo = write_llff(folder / "llff") / "images_8" / "im08.png"
    photo.unlink()  # of a test view: one that no run reads is not looked at
    os.mkfifo(photo)
    return scene("llff", folder / "llff", told="expected a regular file, got a pipe")


def odd_name(folder: Path) -> list[Call]:
    photos = os.fsencode(write_llff(folder / "llff") / "images_8")
    os.rename(photos + b"/im01.png", photos + b"/im01\xff.png")
    return scene("llff", folder / "llff", told="UTF-8")


def frames_equal(count: int, folder: Path) -> list[Call]:
    write_transforms(folder / "t", lambda data: data.update(frames=frames(1) * count))
    return scene("transforms", folder / "t", "scene.near=1", "scene.far=10")


def far_frame(folder: Path) -> list[Call]:
    """A view far beyond all others, which is a test view."""

    def change(data: dict[str, object]) -> None:
        data["frames"] = frames()
        data["frames"][8]["transform_matrix"][0][3] = 1e300  # type: ignore[index]

    write_transforms(folder / "t", change)
    return scene("transforms", folder / "t", "scene.near=1", "scene.far=10")


def colmap(change: Callable[[str], str], file: str, folder: Path) -> list[Call]:
    model = write_scene(folder / "c") / "sparse" / "0" / file
    old = model.read_text()
    model.write_text(change(old))
    assert model.read_text() != old
    return scene("colmap", folder / "c")


def swapped(old: str, new: str) -> Callable[[str], str]:
    return lambda text: text.replace(old, new)


POSE = "\n4 1 0 0 0 "  # of the fourth photo: its number and quaternion
FOCALS = " 50.0 50.0 "


# The system


def small_disk(folder: Path, options: str) -> bool:
    """Put a file system in memory at `folder`, which `judge` takes away, if allowed."""
    folder.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(folder)]
    return subprocess.run(command, capture_output=True, check=False).returncode == 0


def full_cache(folder: Path) -> list[Call]:
    if not small_disk(folder / "disk", "size=64k"):
        return []
    inside = {"NUMBA_CACHE_DIR": str(folder / "disk")}
    return [Call([*SMALL], told="free some space", cpu_s=None, inside=inside)]


def full_results(folder: Path) -> list[Call]:
    if not small_disk(folder / "disk", "size=64k"):
        return []
    words = [*SMALL, f"hydra.run.dir={folder / 'disk' / 'run'}"]
    return [Call([*words], told="free some space", cpu_s=None)]


def sealed_results(folder: Path) -> list[Call]:
    if not small_disk(folder / "disk", "ro"):
        return []
    words = [*SMALL, f"hydra.run.dir={folder / 'disk' / 'run'}"]
    return [Call([*words], told="Read-only")]


def little_memory(folder: Path) -> list[Call]:
    amounts = (300, 700, 1200, 1600, 2000)
    return [Call([*SMALL], told="memory: ", address=a * MIB) for a in amounts]


LONG, DIGITS = "a" * 300, "1" * 5000
TRACE = "a traceback"
CASES = [
    Case(
        "LPIPS weights of infinite distance, twice",
        "repeated for ever, no report",
        weights,
        begun,
    ),
    forged_case("alias bomb", "27 s, 1.3 GB and growing"),
    *(forged_case(name, TRACE) for name in ("brackets", "list", "scene without a name", "date")),
    *(forged_case(name, TRACE) for name in ("trainer text", "trainer null", "packages", "git")),
    *(forged_case(name, TRACE) for name in ("mathtext", "surrogate", "long text", "long name")),
    forged_case("bytes in its name", TRACE),
    forged_case("render pipe", "a hang"),
    forged_case("markup", "held"),
    Case("report --out where nothing can be written", TRACE, unwritable),
    Case(
        "the lock of a study is a link to a file",
        "not tried; the file was overwritten",
        partial(odd_lock, lambda lock, file: lock.symlink_to(file)),
        kept,
    ),
    Case(
        "the lock of a study is a pipe",
        f"not tried; {TRACE}",
        partial(odd_lock, lambda lock, file: os.mkfifo(lock)),
    ),
    Case("the renders of a run lead elsewhere", "not tried; written there", linked_run, kept),
    Case("a pipe as a photo", "a hang", pipe_as_photo),
    Case("a photo whose name is not UTF-8", TRACE, odd_name),
    Case("100,000 equal frames", "quadratic: a hang", partial(frames_equal, 100_000)),
    Case("a test view at 1e300", "it entered the mean", far_frame),
    *(
        Case(name, before, partial(colmap, swapped(old, new), file))
        for name, before, file, old, new in (
            ("a quaternion of 0", "accepted", "images.txt", POSE, "\n4 0 0 0 0 "),
            ("a quaternion five-fold", "accepted", "images.txt", POSE, "\n4 5 0 0 0 "),
            ("fy = 0", TRACE, "cameras.txt", FOCALS, " 50.0 0.0 "),
            ("fy < 0", "told as divergence", "cameras.txt", FOCALS, " 50.0 -50.0 "),
            ("a position of 1e300", "it entered the mean", "images.txt", " -0.8", " 1e300"),
        )
    ),
    Case("study= of 300 characters", TRACE, line(f"study={LONG}", "-m", told="name too long")),
    Case("scene.path= of 4,000", TRACE, line("scene=colmap", f"scene.path={'b' * 4000}")),
    Case("hydra.run.dir= of 300", TRACE, line(f"hydra.run.dir={LONG}", told="name too long")),
    Case("a word that is not UTF-8", TRACE, line("scene=colmap", b"scene.path=\xff", told="UTF-8")),
    Case("seed= of 5,000 digits", TRACE, line(f"seed={DIGITS}", told="usual length")),
    Case("=3", TRACE, line("=3", told="cannot read '=3'")),
    Case("hydra.searchpath=[file:///]", TRACE, line("hydra.searchpath=[file:///]")),
    Case(
        "interval(0,1) without a search",
        "error: Refused",
        line("-m", "reg.start=interval(0,1)", told="expected values to sweep over"),
    ),
    Case("a kernel cache that is full", TRACE, full_cache),
    Case("a disk for results that is full", "held", full_results),
    Case("a disk for results that is sealed", "held", sealed_results),
    Case("300 to 2,000 MiB of address space", "a crash", little_memory),
]


@dataclass(frozen=True)
class Row:
    case: Case
    calls: int
    last: End
    cpu_s: float
    memory_mb: float
    fault: str


def judge(case: Case, folder: Path) -> Row:
    folder.mkdir()
    try:
        fault, ends = "", list[End]()
        for call in case.make(folder):
            end = give(call, folder)
            ends.append(end)
            fault = fault or wrong(call, end)
        fault = fault or (case.check(folder) if ends else "not tried: no right to mount")
    finally:
        subprocess.run(["umount", "-l", str(folder / "disk")], capture_output=True, check=False)
        shutil.rmtree(folder, ignore_errors=True)
    last = ends[-1] if ends else End(0, "", 0.0, 0.0)
    cpu_s = max((end.cpu_s for end in ends), default=0.0)
    memory_mb = max((end.memory_mb for end in ends), default=0.0)
    return Row(case, len(ends), last, cpu_s, memory_mb, fault)


def told(row: Row, folder: Path) -> str:
    """What the last call said, short, as a cell."""
    text = row.last.stderr.strip().replace(str(folder), "...") if row.last.code else "done"
    text = text if len(text) < 130 else f"{text[:60]} ... {text[-60:]}"
    return text.replace("|", "\\|").replace("`", "'").replace("<", "&lt;")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", default="", help="cases with this in their names")
    parser.add_argument("--output", type=Path)
    given = parser.parse_args()
    shown = f" --only {given.only!r}" if given.only else ""
    lines = [f"`python benchmarks/safety/refused.py{shown}`", ""]
    lines += ["| what is given | before | now, the last of the calls | calls | CPU s | MB | ok |"]
    lines += ["|---|---|---|---|---|---|---|"]
    rows = list[Row]()
    with tempfile.TemporaryDirectory() as name:
        for number, case in enumerate(CASES):
            if given.only not in case.name:
                continue
            row = judge(case, Path(name) / str(number))
            rows.append(row)
            cells = case.name, case.before, told(row, Path(name) / str(number)), str(row.calls)
            used = f"{row.cpu_s:.1f}", f"{row.memory_mb:.0f}", row.fault or "ok"
            lines.append(f"| {' | '.join((*cells, *used))} |")
            print(lines[-1], flush=True)
    bad = sum(bool(row.fault) for row in rows)
    calls = sum(row.calls for row in rows)
    lines += ["", f"{len(rows)} cases, {calls} calls, {bad} that did not end as they should."]
    print(lines[-1])
    if given.output is not None:
        text = "\n".join(lines) + "\n"
        given.output.write_text(text + below(given.output), encoding="utf-8")
    return int(bool(bad))


if __name__ == "__main__":
    raise SystemExit(main())
