"""Are the parameters of one configuration the same bits everywhere? Prints a table, exits 1 if not.

Runs `run.py +augment=safi +reg=uar` on the embedded scene with 1, 2 and 3 threads, twice each: the
first of each pair with a cold kernel cache, the second with it warm; then in this process, and two
seeds at once under the joblib launcher. Compares the SHA-256 of the final parameters.

    python benchmarks/safety/determinism.py [--steps 300] [--output FILE.md]
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
METHOD = ["+augment=safi", "+reg=uar"]


def parameters_hash(folder: Path) -> str:
    """The hash in a run's record."""
    record = json.loads((folder / "record.json").read_text(encoding="utf-8"))
    return str(record["parameters_sha256"])


def run(arguments: list[str], cache: Path) -> None:
    """`run.py` with `arguments` in a process of its own, generated things in `cache`."""
    environment = {**os.environ, "FISHERSPLAT_CACHE": str(cache)}
    environment.pop("NUMBA_CACHE_DIR", None)
    command = [sys.executable, str(ROOT / "run.py"), *METHOD, *arguments]
    subprocess.run(command, check=True, cwd=ROOT, env=environment, stdout=subprocess.DEVNULL)


def in_process(steps: int, folder: Path) -> None:
    """The same run through the library, in this process."""
    sys.path.insert(0, str(ROOT))
    from framework.command import cli

    code = cli.main([*METHOD, "seed=0", f"trainer.steps={steps}", f"hydra.run.dir={folder}"])
    if code != 0:
        raise SystemExit(code)


def measure(steps: int, work: Path) -> list[tuple[str, str]]:
    """(how it was run, hash) pairs of seed 0."""
    rows = []
    for threads in (1, 2, 3):
        cache = work / f"cache-{threads}"
        for state in ("cold", "warm"):
            folder = work / f"run-{threads}-{state}"
            options = ["seed=0", f"threads={threads}", f"trainer.steps={steps}"]
            run([*options, f"hydra.run.dir={folder}"], cache)
            rows.append((f"{threads} threads, {state} cache", parameters_hash(folder)))
            print(f"| {rows[-1][0]} | `{rows[-1][1][:16]}` |", flush=True)
    in_process(steps, work / "in-process")
    rows.append(("in-process", parameters_hash(work / "in-process")))
    sweep = work / "sweep"
    launcher = ["hydra/launcher=joblib", "hydra.launcher.n_jobs=2", f"hydra.sweep.dir={sweep}"]
    launcher += ["hydra.sweep.subdir=${seed}", "seed=0,1", "threads=1", f"trainer.steps={steps}"]
    run([*launcher, "-m"], work / "cache-1")
    rows.append(("joblib launcher, 2 jobs", parameters_hash(sweep / "0")))
    return rows


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=300)
    parser.add_argument("--output", type=Path)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        rows = measure(arguments.steps, Path(folder))
    hashes = {digest for _, digest in rows}
    lines = [f"`python benchmarks/safety/determinism.py --steps {arguments.steps}`", ""]
    lines += ["| run | SHA-256 of the parameters |", "|---|---|"]
    lines += [f"| {label} | `{digest}` |" for label, digest in rows]
    lines += ["", f"{len(rows)} runs, {len(hashes)} distinct."]
    text = "\n".join(lines) + "\n"
    print(text)
    if arguments.output is not None:
        arguments.output.parent.mkdir(parents=True, exist_ok=True)
        arguments.output.write_text(text, encoding="utf-8")
    return 0 if len(hashes) == 1 else 1


if __name__ == "__main__":
    raise SystemExit(main())
