"""Where the wall time of one run goes, from the start of Python to its end.

    python benchmarks/speed/end_to_end.py [--runs 5] [--output FILE] [OVERRIDE ...]

Each run is a fresh process doing what `python run.py OVERRIDE ...` does, in an empty folder, with
kernels cached by an earlier run. The time of a stage excludes the stages inside it and is measured
on the main thread. For members that train at the same time it is the time of the first one,
including the wait for the others. Prints medians over the runs, or writes them to FILE. The machine
should be idle.
"""

from __future__ import annotations

import argparse
import functools
import importlib
import json
import os
import re
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

CHILD = "--child"
# stage -> functions, as module and name, whose time it is
STAGES = {
    "scene": ["framework.run.experiment:load_scene"],
    "depth, while kernels load": [
        "framework.run.preparation:estimate_depth",
        "framework.run.preparation:check_poses",
        "framework.run.warmup:Warmup.begin",
        "framework.run.warmup:Warmup.finish",
    ],
    "initial Gaussians": ["framework.run.experiment:initial"],
    "training: the steps themselves": ["framework.train.trainer:Trainer.run"],
    "training: pseudo views": ["framework.train.plugin_calls:PluginCalls.pseudo_views"],
    "training: the regularizer": ["framework.train.plugin_calls:PluginCalls.regularization"],
    "training: the capacity plugin": ["framework.train.trainer:Trainer._edit"],
    "training: Fisher information": ["framework.fisher.information:fisher_information"],
    "training: checkpoints": ["framework.train.resume.checkpoint:Checkpoints.keep"],
    "test PSNR along the way": ["framework.train.trainer:Trainer._record"],
    "evaluation: rendering": ["framework.run.experiment:evaluate"],
    "evaluation: PSNR, SSIM, FLIP": ["framework.metrics.evaluate:_measured"],
    "files": ["framework.run.experiment:write_run"],
    "identity of code, packages and files": [
        "framework.run.experiment:file_fingerprints",
        "framework.run.experiment:identity_of",
        "framework.run.experiment:code_hash",
    ],
}
START, REST = "Python, libraries, command line", "the rest of the run"
REPORT, END = "report", "ending the process"


class Clock:
    """Seconds per stage, each without what is measured inside it."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)
        self._inside = [0.0]  # per open stage: time of the stages inside it

    def watch(self, stage: str, function: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(function)
        def watched(*args: Any, **kwargs: Any) -> Any:
            if threading.current_thread() is not threading.main_thread():
                return function(*args, **kwargs)  # not part of what is measured
            start = time.perf_counter()
            self._inside.append(0.0)
            try:
                return function(*args, **kwargs)
            finally:
                total = time.perf_counter() - start
                self.seconds[stage] += total - self._inside.pop()
                self._inside[-1] += total

        return watched

    @property
    def measured(self) -> float:
        return self._inside[0]


def child(began: float, output: Path, overrides: list[str]) -> None:
    """One run with a clock around its stages; `began` is the time when the process was started."""
    from framework.command import runner
    from framework.command.cli import main

    clock, run = Clock(), runner.run
    ended = began

    def watched(job: Any) -> None:
        """The run, with a clock around its stages."""
        nonlocal ended
        importlib.import_module("framework.run.experiment")
        clock.seconds[START] = time.time() - began
        for stage, places in STAGES.items():
            for place in places:
                module, _, path = place.partition(":")
                *owners, name = path.split(".")
                owner = functools.reduce(getattr, owners, importlib.import_module(module))
                setattr(owner, name, clock.watch(stage, getattr(owner, name)))
        run(job)
        ended = time.time()
        clock.seconds[REST] = ended - began - clock.seconds[START] - clock.measured

    runner.run = watched
    code = main(overrides)
    clock.seconds[REPORT] = time.time() - ended
    output.write_text(json.dumps(clock.seconds))
    os._exit(code)  # as run.py


def profile(folder: Path, overrides: list[str]) -> dict[str, float]:
    """Seconds per stage of one fresh process, with the `total` as its parent saw it."""
    output = folder / "seconds.json"
    line = [*overrides, "force=true", f"hydra.run.dir={folder / 'run'}"]
    start = time.time()
    command = [sys.executable, __file__, CHILD, repr(start), str(output), *line]
    done = subprocess.run(command, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    total = time.time() - start
    if done.returncode:
        sys.exit(done.stderr.decode().strip().splitlines()[-1])
    stages = json.loads(output.read_text())
    return {**stages, END: total - sum(stages.values()), "total": total}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--output", type=Path)
    parser.add_argument("overrides", nargs="*")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        profile(folder, [*options.overrides, "trainer.steps=10"])
        runs = [profile(folder, options.overrides) for _ in range(options.runs)]
        record = json.loads((folder / "run" / "record.json").read_text())
    from framework.records.provenance import cpu_model

    median = {key: statistics.median(run.get(key, 0.0) for run in runs) for key in runs[0]}
    total = median.pop("total")
    line = re.sub(r"path=\S+", "path=DIR", " ".join(options.overrides))
    psnr, gaussians = record["summary"]["psnr"]["mean"], record["gaussians"]
    rows = [
        f"| {stage} | {median[stage]:.2f} | {100 * median[stage] / total:.0f} % |"
        for stage in (START, *STAGES, REST, REPORT, END)
        if median.get(stage, 0.0) >= 0.005
    ]
    text = "\n".join(
        [
            "# One run from end to end",
            "",
            f"`python benchmarks/speed/end_to_end.py {line}` on {cpu_model()},"
            f" {record['provenance']['threads']} threads: medians of {options.runs} runs;"
            f" test PSNR {psnr:.2f} dB, {gaussians} Gaussians.",
            "",
            "| stage | seconds | share |",
            "|---|---:|---:|",
            *rows,
            f"| **all** | {total:.2f} | |",
            "",
        ]
    )
    print(text)
    if options.output:
        options.output.write_text(text)


if __name__ == "__main__":
    if sys.argv[1:2] == [CHILD]:
        child(float(sys.argv[2]), Path(sys.argv[3]), sys.argv[4:])
    else:
        main()
