"""Are the bits the same on any number of threads and on any processor? Prints tables, exits 1 if
not.

Runs `run.py +augment=safi +reg=uar` on the embedded scene with 1, 2 and 3 threads, twice each: the
first of each pair with a cold kernel cache, the second with it warm; then in this process, and two
seeds at once under the joblib launcher. Compares the SHA-256 of the final parameters.

Then every stage of `stages.py` on simulated processors: the libraries and the C library are told to
leave out what lesser ones lack, and the kernels are compiled for them. LPIPS is left out of the one
hash, as PyTorch's convolutions are other code on each.

With --only plugins: which plugins' trainings follow the processor, as they use PyTorch's functions.

    python benchmarks/safety/determinism.py [--steps 300] [--output FILE.md]
        [--only threads|cpus|plugins]

The suite compares the stages with `tests/golden/bits.json`. After a change that is meant to change
numbers:

    python benchmarks/safety/determinism.py --update
"""

from __future__ import annotations

import argparse
import hashlib
import importlib.metadata
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
METHOD = ["+augment=safi", "+reg=uar"]


STAGES = Path(__file__).with_name("stages.py")
BITS = ROOT / "tests" / "golden" / "bits.json"
LIBRARIES = ("numpy", "scipy", "torch", "numba", "llvmlite", "opencv-contrib-python-headless")
LIBRARIES += ("pillow", "scikit-image", "pandas")
FOLLOWING = ("metric lpips", "report")  # stages whose bits are not in the one hash

_AVX512 = "-AVX512F,-AVX512VL,-AVX512BW,-AVX512DQ"
AVX2 = {
    "NPY_DISABLE_CPU_FEATURES": "X86_V4 AVX512_ICL",
    "OPENBLAS_CORETYPE": "Haswell",
    "ATEN_CPU_CAPABILITY": "avx2",
    "MKL_ENABLE_INSTRUCTIONS": "AVX2",
    "MKL_CBWR": "AVX2",
    "ONEDNN_MAX_CPU_ISA": "AVX2",
    "OPENCV_CPU_DISABLE": "AVX512-SKX",
    "OPENCV_IPP": "avx2",
    "GLIBC_TUNABLES": f"glibc.cpu.hwcaps={_AVX512}",
}
SSE = {
    "NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4 AVX512_ICL",
    "OPENBLAS_CORETYPE": "Nehalem",
    "ATEN_CPU_CAPABILITY": "default",
    "MKL_ENABLE_INSTRUCTIONS": "SSE4_2",
    "MKL_CBWR": "COMPATIBLE",  # the switch above changed nothing on an AMD
    "ONEDNN_MAX_CPU_ISA": "SSE41",
    "OPENCV_CPU_DISABLE": "AVX512-SKX,AVX2,FMA3,AVX,FP16",
    "OPENCV_IPP": "sse42",
    "GLIBC_TUNABLES": f"glibc.cpu.hwcaps={_AVX512},-AVX2,-FMA,-FMA4,-AVX,-BMI2,-SSE4_1",
    "JSIMD_FORCENONE": "1",
}
CPUS: dict[str, dict[str, str]] = {
    "this one": {},
    "libraries with AVX2 and FMA": AVX2,
    "libraries with SSE 4.2 alone": SSE,
    "all with AVX2 and FMA (Haswell)": {**AVX2, "NUMBA_CPU_NAME": "haswell"},
    "all with SSE 4.2 alone (Nehalem)": {**SSE, "NUMBA_CPU_NAME": "nehalem"},
}


def stages(
    changes: dict[str, str], kernels: str | None = None, names: Sequence[str] = ()
) -> dict[str, str]:
    """Stage -> hash, computed where the environment has these `changes`; generated things are not
    taken from a cache but the kernels, whose cache tells processors apart. names: of the stages of
    `stages.py`, without any the usual ones."""
    with tempfile.TemporaryDirectory() as cache:
        environment = {**os.environ, "FISHERSPLAT_CACHE": cache, **changes}
        environment["NUMBA_CACHE_DIR"] = kernels or _kernel_cache()
        command = [sys.executable, str(STAGES), *names]
        done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)
    if done.returncode != 0:
        raise SystemExit(f"{command}: {done.stderr[-2000:]}")
    found: dict[str, str] = json.loads(done.stdout)
    return found


def _kernel_cache() -> str:
    code = "from framework.compute.jit import KERNEL_CACHE; print(KERNEL_CACHE)"
    command = [sys.executable, "-c", code]
    return subprocess.run(command, check=True, cwd=ROOT, capture_output=True, text=True).stdout[:-1]


def committed(found: dict[str, str]) -> dict[str, str]:
    """Of the stages those that the one hash is of."""
    return {stage: bits for stage, bits in found.items() if not stage.startswith(FOLLOWING)}


def one_hash(found: dict[str, str]) -> str:
    """Of all stages but those that follow the processor."""
    return hashlib.sha256(json.dumps(committed(found), sort_keys=True).encode()).hexdigest()


def versions() -> dict[str, str]:
    """Of the libraries that compute."""
    return {name: importlib.metadata.version(name) for name in LIBRARIES}


def simulated() -> tuple[list[str], bool]:
    """A table of the simulated processors, and whether all have one hash."""
    lines = ["| processor | one hash | stages that differ from this one |", "|---|---|---|"]
    first: dict[str, str] = {}
    hashes = set()
    for name, changes in CPUS.items():
        found = stages(changes)
        first = first or found
        differ = sorted(stage for stage in found if found[stage] != first[stage])
        hashes.add(one_hash(found))
        lines.append(f"| {name} | `{one_hash(found)[:16]}` | {', '.join(differ) or 'none'} |")
        print(lines[-1], flush=True)
    lines += ["", f"{len(first)} stages, {len(hashes)} distinct hash."]
    return lines, len(hashes) == 1


def of_plugins() -> list[str]:
    """Which plugins' trainings are the same on libraries with and without vector instructions."""
    here, there = (stages(changes, names=("plugins",)) for changes in ({}, SSE))
    differ = sorted(words for words in here if here[words] != there[words])
    same = sorted(here.keys() - set(differ))
    return [
        f"Trainings that are the same with SSE 4.2 alone ({len(same)}): {', '.join(same)}.",
        "",
        f"Those that differ ({len(differ)}): {', '.join(differ) or 'none'}.",
    ]


def update() -> None:
    """Make what this checkout computes the bits that the suite expects."""
    found = committed(stages({}))
    content = {"versions": versions(), "stages": found}
    BITS.write_text(json.dumps(content, indent=2, sort_keys=True) + "\n", encoding="utf-8")
    print(f"{BITS.relative_to(ROOT)}: {one_hash(found)}")


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
    parser.add_argument("--only", choices=("threads", "cpus", "plugins"))
    parser.add_argument("--update", action="store_true")
    arguments = parser.parse_args()
    if arguments.update:
        update()
        return 0
    only = f" --only {arguments.only}" if arguments.only else ""
    lines = [f"`python benchmarks/safety/determinism.py --steps {arguments.steps}{only}`", ""]
    hashes, same = set[str](), True
    if arguments.only == "plugins":
        print("\n".join(of_plugins()))
        return 0
    if arguments.only != "cpus":
        with tempfile.TemporaryDirectory() as folder:
            rows = measure(arguments.steps, Path(folder))
        hashes = {digest for _, digest in rows}
        lines += ["| run | SHA-256 of the parameters |", "|---|---|"]
        lines += [f"| {label} | `{digest}` |" for label, digest in rows]
        lines += ["", f"{len(rows)} runs, {len(hashes)} distinct.", ""]
    if arguments.only != "threads":
        table, same = simulated()
        lines += table
    text = "\n".join(lines) + "\n"
    print(text)
    if arguments.output is not None:
        arguments.output.parent.mkdir(parents=True, exist_ok=True)
        arguments.output.write_text(text, encoding="utf-8")
    return 0 if len(hashes) <= 1 and same else 1


if __name__ == "__main__":
    raise SystemExit(main())
