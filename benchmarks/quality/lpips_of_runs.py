"""LPIPS of finished runs, from the renders that they saved: of code that could not measure it, too.

    python benchmarks/quality/lpips_of_runs.py RUN...

RUN: folders of runs. Network: VGG, by the weights that `fishersplat fetch lpips` fetched. Prints a
row for each run (its own PSNR; LPIPS with images fed in [0, 1] and in [-1, 1]) and their mean. A
run's `renders/` holds 8-bit images, as its own LPIPS is measured on: where a run measured it, this
prints the same number.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from framework.metrics.evaluate import FETCH_LPIPS, lpips
from framework.metrics.lpips import Lpips, load
from framework.metrics.lpips_weights import cached

TRUTH = "_truth.png"


def pixels(file: Path) -> Tensor:
    """[3, H, W] in [0, 1]."""
    with Image.open(file) as image:
        return torch.from_numpy(np.asarray(image.convert("RGB")).transpose(2, 0, 1) / 255.0)


def measured(run: Path, network: Lpips) -> tuple[float, float, float]:
    """PSNR as the run tells it; the mean over its test views of LPIPS fed [0, 1], and [-1, 1]."""
    record = json.loads((run / "record.json").read_text(encoding="utf-8"))
    found = []
    for truth in sorted((run / "renders").glob(f"*{TRUTH}")):
        view = str(truth).removesuffix(TRUTH)
        mask_file = Path(f"{view}_mask.png")
        mask = (pixels(mask_file)[0] > 0.5).float() if mask_file.exists() else None
        pair = pixels(Path(f"{view}.png")), pixels(truth)
        found.append([lpips(*pair, network, mask, centred) for centred in (False, True)])
    if not found:
        raise SystemExit(f"{run}: expected a run with renders of test views, found none")
    fed, centred = np.mean(np.array(found, np.float64), axis=0)
    return float(record["summary"]["psnr"]["mean"]), float(fed), float(centred)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("runs", type=Path, nargs="+", metavar="RUN")
    given = parser.parse_args()
    weights = cached("vgg")
    if weights is None:
        parser.error(f"no weights; fetch them once with `{FETCH_LPIPS}`")
    network = load(weights)
    print("| run | PSNR | LPIPS, [0, 1] | LPIPS, [-1, 1] |\n|---|---:|---:|---:|")
    rows = []
    for run in given.runs:
        rows.append(measured(run, network))
        psnr, *distances = rows[-1]
        print(f"| {run.name} | {psnr:.2f} | {distances[0]:.4f} | {distances[1]:.4f} |", flush=True)
    psnr, *distances = np.mean(rows, axis=0)
    print(f"| mean | {psnr:.2f} | {distances[0]:.4f} | {distances[1]:.4f} |")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
