"""All that a machine with CUDA has to show of `rasterizer=gsplat`, in one command. Prints tables.

    python benchmarks/speed/gpu.py [--data DIR] [--against gsplat] [--output FILE.md]

Equality of image, gradients and Fisher information with the numba kernels, at opacities below both
ends of alpha; seconds of whole runs on the built-in scene, with `preset=paper`, and
with --data DIR (a folder with `fern` and `fox`) on fern with 3 views and fox with 43; the spread
over repetitions of one seed with that over seeds. `--against reference --small` tries the script
itself on a CPU. Refused in one line where the rasterizer cannot run.
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

SMALL = ["scene.width=96", "scene.height=72", "init.budget=400", "trainer.steps=10"]
METHOD = ["augment=safi", "reg=uar"]


def equality(name: str) -> list[str]:
    """Largest differences of the rasterizer from the kernels on a random scene."""
    import torch

    from framework.backends import NUMBA, Rasterizer, build_rasterizer
    from tests.backends.test_contract import how, scene, sure

    other, case = build_rasterizer({"rasterizer": {"name": name}}), scene(3)
    at = sure(case)

    def found(who: Rasterizer) -> list[torch.Tensor]:
        seen = who.render(case.gaussians, case.camera, **how(case)).to("cpu")
        placed = case.gaussians.to(who.device)
        photo = torch.full((3, *at.shape), 0.4)
        target = who.losses().target(photo, at.float(), who.device)
        gradient = who.render_gradient(
            placed,
            case.camera,
            lambda rgb: who.losses().loss_gradient(rgb, target, 0.2, 1.0)[1],
            **how(case),
        )
        tensors, means2d = gradient.pull_back()
        block = who.fisher(case.gaussians, case.camera).block
        whole = torch.cat([t.flatten() for t in (*tensors.values(), means2d)]).cpu()
        return [seen.rgb[:, at], seen.depth[at], whole, block]

    rows = []
    for what, ours, theirs in zip(
        ("colours", "depth", "gradients", "Fisher blocks"), found(NUMBA), found(other), strict=True
    ):
        error = float((ours - theirs).abs().max() / ours.abs().max())
        rows.append(f"| {what} | {error:.1e} | {'yes' if error < 1e-4 else 'no'} |")
    return rows


def run(name: str, words: list[str], folder: Path) -> dict[str, float]:
    """Wall and training seconds, and test PSNR, of one run."""
    words = [*words, f"rasterizer={name}", f"hydra.run.dir={folder}", "force=true"]
    started = time.perf_counter()
    subprocess.run(
        [sys.executable, str(ROOT / "run.py"), *words], check=True, stdout=subprocess.DEVNULL
    )
    record = json.loads((folder / "record.json").read_text(encoding="utf-8"))
    train = next(stage for stage in record["timings"] if stage["stage"] == "train")
    steps = record["config"]["trainer"]["steps"]
    return {
        "wall": time.perf_counter() - started,
        "train": train["wall_s"],
        "step": train["wall_s"] / steps,
        "psnr": record["summary"]["psnr"]["mean"],
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path)
    parser.add_argument("--against", default="gsplat")
    parser.add_argument("--small", action="store_true")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    from framework.backends import build_rasterizer
    from framework.errors import UserError

    try:
        build_rasterizer({"rasterizer": {"name": options.against}}).ready()
    except UserError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    names, least = ("numba", options.against), [*(SMALL if options.small else [])]
    runs = {"built-in scene": [*METHOD, *least]}
    if not options.small:
        runs["built-in scene, preset=paper"] = ["preset=paper", *METHOD]
    if options.data:
        runs["fern, 3 views"] = ["scene=llff", f"scene.path={options.data / 'fern'}", *METHOD]
        fox = ["scene=transforms", f"scene.path={options.data / 'fox'}", "scene.n_views=43"]
        runs["fox, 43 views"] = [*fox, *METHOD]
    lines = ["| what | largest difference, of the largest value | below 1e-4 |", "|---|---|---|"]
    lines += [*equality(options.against), "", "| run | rasterizer | run [s] | training [s] |"]
    lines[-1] += " step [ms] | PSNR [dB] |"
    lines.append("|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as temporary:
        for title, words in runs.items():
            for name in names:
                r = run(name, words, Path(temporary) / "run")
                numbers = f"{r['wall']:.1f} | {r['train']:.1f} | {1000 * r['step']:.1f}"
                lines.append(f"| {title} | {name} | {numbers} | {r['psnr']:.2f} |")
        spread = {}
        for what, seeds in (
            ("seed 0 again", [0] * options.repeats),
            ("seeds", range(options.repeats)),
        ):
            base = [*METHOD, *least]
            values = [
                run(options.against, [*base, f"seed={seed}"], Path(temporary) / "run")["psnr"]
                for seed in seeds
            ]
            spread[what] = statistics.stdev(values)
    lines += [
        "",
        *(f"Sigma of PSNR over {options.repeats} x {w}: {s:.4f} dB" for w, s in spread.items()),
    ]
    text = "\n".join(lines) + "\n"
    print(text)
    if options.output:
        options.output.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
