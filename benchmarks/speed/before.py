"""What a step of a training costs beside an earlier commit's: the same trainings in turns.

    git worktree add --detach DIR COMMIT
    python benchmarks/speed/before.py DIR [--rounds 5] [--steps 300] [--output FILE]

A training of the baseline without plugins, by `Trainer`, with 1 thread: of 200 Gaussians on three
images of 64x48, where what is around the kernels weighs most, and of 10,000 on one of 252x189. Each
round is a fresh process of the one and of the other, which of them first in turn. The ratio is the
median over the rounds; CPU is the process' own time, which other programs disturb less than wall.
Whether both end at the same bits is told, too: they do the same work only then.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import statistics
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
ALONE = os.environ | {"NUMBA_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
SIZES = {"200 Gaussians, 64x48": 0, "10,000 Gaussians, 252x189": 10_000}


def child(root: Path, n: int, steps: int) -> None:
    """Train with the code in `root`; prints what it took a step, and a hash of the result."""
    sys.path.insert(0, str(root))
    from dataclasses import replace

    import framework
    from framework import registry
    from framework.options import TrainerOptions
    from framework.rasterize import rasterize
    from framework.records.progress import Silent
    from framework.run import warmup
    from framework.train.trainer import Plugins, Trainer

    assert Path(framework.__file__).resolve().parents[1] == root.resolve(), framework.__file__
    registry.discover()
    known = vars(warmup)
    plane = known.get("textured_plane") or known["_plane"]  # as it was called before
    training, depth, gaussians = plane(3)
    if n:
        from benchmarks.scene import layered_scene

        gaussians, camera = layered_scene(n, factor=0.5)
        image = rasterize(gaussians, camera).rgb.detach().contiguous()
        views = [replace(training.views[0], camera=camera, image=image)]
        training = replace(training, views=tuple(views))
        depth = depth[:1]
        gaussians = gaussians.replace(means=gaussians.means * 1.001)
    names = {"augment": "none", "reg": "none", "capacity": "fixed"}

    def run(length: int) -> tuple[float, float, str]:
        options = TrainerOptions(
            steps=length, evaluations=1, coarse_until=0.0, ssim_weight=0.2, lr_scale=5.0
        )
        given = (registry.build(group, {"name": name}) for group, name in names.items())
        known = (training, depth, gaussians, options, Plugins(*given), 0, Silent())
        trainer = Trainer(*known, tells=False)
        wall, cpu = time.perf_counter(), time.process_time()
        found = trainer.run().gaussians
        spent = time.perf_counter() - wall, time.process_time() - cpu
        text = b"".join(tensor.numpy().tobytes() for _, tensor in found.items())
        return *(1e3 * s / length for s in spent), hashlib.sha256(text).hexdigest()[:12]

    run(10)
    print(json.dumps(run(steps)))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("before", type=Path)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--steps", type=int, default=300)
    parser.add_argument("--output", type=Path)
    parser.add_argument("--child", type=int, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.child is not None:
        child(given.before, given.child, given.steps)
        return 0
    folders = {"before": given.before.resolve(), "now": ROOT}
    lines = [
        "| training | before: CPU ms a step | now | ratio of medians: CPU | wall | same bits |",
        "|---|---|---|---|---|---|",
    ]
    for title, n in SIZES.items():
        times: dict[str, list[list[float]]] = {name: [] for name in folders}
        bits = set()
        for turn in range(given.rounds):
            for name in sorted(folders, reverse=turn % 2 == 1):
                command = [sys.executable, __file__, str(folders[name])]
                command += ["--child", str(n), "--steps", str(given.steps)]
                told = subprocess.run(
                    command, cwd=folders[name], env=ALONE, check=True, stdout=subprocess.PIPE
                )
                *spent, digest = json.loads(told.stdout.splitlines()[-1])
                times[name].append(spent)
                bits.add(digest)
        wall, cpu = (
            {name: statistics.median(row[i] for row in rows) for name, rows in times.items()}
            for i in (0, 1)
        )
        lines.append(
            f"| {title} | {cpu['before']:.3f} | {cpu['now']:.3f}"
            f" | {cpu['now'] / cpu['before']:.3f} | {wall['now'] / wall['before']:.3f}"
            f" | {'yes' if len(bits) == 1 else 'no'} |"
        )
    text = "\n".join(lines) + "\n"
    print(text)
    if given.output:
        given.output.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
