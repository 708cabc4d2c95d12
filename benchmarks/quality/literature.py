"""What each method of the literature adds to our defaults on one scene: a row each, trained one
after the other in this process, so that their CPU seconds compare.

    python benchmarks/quality/literature.py [--methods a,b] [--seeds 0] [overrides of run.py]

Prints PSNR of the test views, the difference to `baseline`, the co-adaptation score (lower is
better), CPU seconds of the training over those of `baseline`, and the number of Gaussians. A method
is `method=NAME`, or overrides joined by `;`.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from benchmarks.prepare import prepared  # noqa: E402
from framework.command.config.schema import CONF_DIR  # noqa: E402

HERE = sorted(path.stem for path in (CONF_DIR / "method").glob("*_here.yaml"))


def row(method: str, seed: int, overrides: Sequence[str]) -> tuple[float, float, float, int]:
    """(PSNR in dB, co-adaptation score, CPU seconds, Gaussians) of one training."""
    from framework.compute import parallel
    from framework.compute.rng import stream
    from framework.metrics.coadaptation import coadaptation
    from framework.metrics.evaluate import psnr
    from framework.rasterize import rasterize

    parallel.set_threads(1)
    chosen = method.split(";") if "=" in method else [f"method={method}"]
    ready = prepared([*overrides, *chosen, f"seed={seed}"])
    began = time.process_time()
    trained = ready.trained()
    seconds = time.process_time() - began
    gaussians, near = trained.gaussians, ready.scene.training.near
    fixed = {
        "background": trained.background,
        "sh_degree": trained.sh_degree,
        "near": ready.config["trainer"]["near_plane"] * near,
    }
    found = [
        psnr(rasterize(gaussians, view.camera, **fixed).rgb, view.image, view.mask)
        for view in ready.scene.test
    ]
    errors = [value for value in found if isinstance(value, float)]
    score = coadaptation(
        lambda camera, factors: rasterize(gaussians, camera, opacity_factors=factors, **fixed),
        len(gaussians),
        [view.camera for view in ready.scene.test],
        stream(seed, "coadaptation"),
    )
    return sum(errors) / len(errors), score, seconds, len(gaussians)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--methods", default=",".join(["baseline", *HERE]))
    parser.add_argument("--seeds", default="0")
    arguments, overrides = parser.parse_known_args()
    print("| method | seed | PSNR | against baseline | CA x 1000 | CPU | Gaussians |")
    print("|---|---|---|---|---|---|---|")
    row("baseline", 0, [*overrides, "trainer.steps=2"])  # compiled, loaded
    for seed in map(int, arguments.seeds.split(",")):
        plain: tuple[float, float] | None = None
        for method in arguments.methods.split(","):
            psnr, score, seconds, n = row(method, seed, overrides)
            plain = plain or (psnr, seconds)
            cells = (method, seed, f"{psnr:.2f}", f"{psnr - plain[0]:+.2f}", f"{1000 * score:.2f}")
            told = " | ".join(map(str, (*cells, f"{seconds / plain[1]:.2f}", f"{n:,}")))
            print(f"| {told} |", flush=True)


if __name__ == "__main__":
    main()
