"""A study of 200 runs, three of which a plugin breaks: is it complete, are the failures told, and
does it give the same numbers in another order and with another launcher? Exits with 1 if not.

The plugin `reg=fragile` is installed for the benchmark as any third-party one would be. It lets the
three seeds with the smallest draws fail: by an exception, or by a loss that is not finite.

    python benchmarks/safety/many_runs.py [--runs 200] [--output benchmarks/results/many_runs.md]
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from benchmarks.studies import digests, leftovers, parameters  # noqa: E402
from framework.compute.rng import stream  # noqa: E402

BROKEN = 3
STUDY = [
    *("study=many", "reg=fragile", "threads=1", "depth=ground_truth", "init.budget=300"),
    *("scene.width=64", "scene.height=48", "scene.supersampling=1"),
    *("trainer.steps=12", "trainer.evaluations=1"),
]
ENTRY_POINT = "[fishersplat.plugins]\nfragile = fragile\n"
PLUGIN = '''"""`reg=fragile`: breaks for the seeds whose first draw is small."""

from dataclasses import dataclass

from framework.plugin import Regularizer, register


@register("reg", "fragile")
@dataclass(frozen=True)
class Fragile(Regularizer):
    """below: seeds with a smaller first draw fail, some of them by a loss of NaN."""

    below: float = 0.0

    def loss(self, ctx, state, view, render):
        draw = ctx.rng("fate").random()
        if ctx.step > 0 or draw >= self.below:
            return None
        if int(draw * 1e8) % 2:
            return render.rgb.sum() * float("nan")
        raise RuntimeError("planted")
'''


@dataclass(frozen=True)
class Way:
    """One way to run the study, and what came of it."""

    name: str
    code: int
    listed: int
    wall_s: float
    study: Path


def install(site: Path) -> None:
    """Make the plugin an installed distribution in the folder `site`."""
    metadata = site / "fragile-1.0.dist-info"
    metadata.mkdir(parents=True)
    (site / "fragile.py").write_text(PLUGIN, encoding="utf-8")
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: fragile\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text(ENTRY_POINT)


def fates(runs: int) -> tuple[list[int], float]:
    """The seeds that will fail, and the bound that makes them."""
    draws = sorted((stream(seed, "reg/fate").random(), seed) for seed in range(runs))
    bound = (draws[BROKEN - 1][0] + draws[BROKEN][0]) / 2
    return sorted(seed for _, seed in draws[:BROKEN]), bound


def run(name: str, words: list[str], site: Path, folder: Path) -> Way:
    """The study in a process of its own."""
    folder.mkdir()
    environment = {**os.environ, "PYTHONPATH": f"{site}{os.pathsep}{ROOT}"}
    started = time.monotonic()
    done = subprocess.run(
        [sys.executable, str(ROOT / "run.py"), "-m", *STUDY, *words],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
    )
    wall_s = time.monotonic() - started
    errors = [line for line in done.stderr.splitlines() if line.startswith("error: ")]
    print(f"{name}: exit code {done.returncode}, {wall_s:.0f} s", *errors, sep="\n  ", flush=True)
    study = folder / "reports" / "many"
    report = (study / "report.md").read_text(encoding="utf-8")
    failed = [path.parent.name for path in study.glob("runs/*/failed.json")]
    return Way(name, done.returncode, sum(name in report for name in failed), wall_s, study)


def measure(runs: int, work: Path) -> tuple[list[Way], list[str]]:
    """All ways, and what is wrong with them."""
    install(work / "site")
    broken, bound = fates(runs)
    words = [f"reg.below={bound!r}"]
    forwards, backwards = f"seed=range({runs})", f"seed=range({runs - 1},-1,-1)"
    joblib = ["hydra/launcher=joblib", "hydra.launcher.n_jobs=2"]
    ways = [
        run("in order", [*words, forwards], work / "site", work / "a"),
        run("in reverse order", [*words, backwards], work / "site", work / "b"),
        run("joblib launcher, 2 jobs", [*words, *joblib, forwards], work / "site", work / "c"),
    ]
    expected, problems = digests(ways[0].study), list[str]()
    for way in ways:
        hashes = parameters(way.study)
        failed = sorted(
            int(path.parent.name.split("-s")[1].split("-")[0])
            for path in way.study.glob("runs/*/failed.json")
        )
        checks = {
            f"{len(hashes)} complete runs": len(hashes) == runs - BROKEN,
            f"failed seeds {failed}": failed == broken,
            f"{way.listed} failures in the report": way.listed == BROKEN,
            f"exit code {way.code}": way.code != 0,
            f"leftovers {leftovers(way.study)}": not leftovers(way.study),
        }
        found = digests(way.study)
        differing = sorted(k for k in {*found, *expected} if found.get(k) != expected.get(k))
        checks[f"differs from the first: {differing[:5]} ..."] = not differing
        problems += [f"{way.name}: {text}" for text, good in checks.items() if not good]
    return ways, problems


def table(ways: list[Way], problems: list[str], runs: int) -> str:
    lines = [f"`python benchmarks/safety/many_runs.py --runs {runs}`", ""]
    lines += ["| way | complete | failures in the report | exit code | wall s |"]
    lines += ["|---|---|---|---|---|"]
    for way in ways:
        complete = len(parameters(way.study))
        numbers = f"{complete} | {way.listed} | {way.code} | {way.wall_s:.0f}"
        lines.append(f"| {way.name} | {numbers} |")
    verdict = (
        "Parameters, metrics, renders and report are the same bytes all three ways, measured times"
        f" aside; the {BROKEN} planted failures are those listed."
    )
    return "\n".join([*lines, "", *(problems or [verdict])]) + "\n"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--output", type=Path)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        ways, problems = measure(arguments.runs, Path(folder))
        text = table(ways, problems, arguments.runs)
    print(text)
    if arguments.output is not None:
        arguments.output.parent.mkdir(parents=True, exist_ok=True)
        arguments.output.write_text(text, encoding="utf-8")
    return int(bool(problems))


if __name__ == "__main__":
    raise SystemExit(main())
